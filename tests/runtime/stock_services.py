"""A stock container behind services that answer when the test orders it."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any

from play_launch.container.messages import Hello, Incoming, Load, Query, Status
from play_launch.ros.composition import CompositionClient, LoadReply, UnloadReply
from play_launch.runtime.stock_link import StockLink

if TYPE_CHECKING:
    pass


async def settle() -> None:
    """Let everything happen that is due now."""
    for _ in range(30):
        await asyncio.sleep(0)


class Services(CompositionClient):
    """Answers lists and unloads truthfully and at once; loads are answered by the test."""

    def __init__(self) -> None:
        self.nodes: dict[int, str] = {}
        self.is_serial = True
        self.is_present = True
        self.loads: list[tuple[Any, asyncio.Future[LoadReply]]] = []
        self.unloaded: list[int] = []
        self.lists = 0
        self.unanswered: list[asyncio.Future[Any]] = []
        self.answers_lists = True
        self.answers_unloads = True
        self.closed = False
        self._changed = asyncio.Event()

    def change(self, *, is_present: bool = True) -> None:
        self.is_present = is_present
        self._changed.set()
        self._changed = asyncio.Event()

    async def ready(self) -> None:
        while not self.is_present:
            await self._changed.wait()

    async def gone(self) -> None:
        while self.is_present:
            await self._changed.wait()

    async def constructs_in_background(self) -> bool:
        return not self.is_serial

    def list_nodes(self) -> asyncio.Future[dict[int, str]]:
        self.lists += 1
        return self._reply(self.answers_lists, dict(self.nodes))

    def load_node(self, request: Any) -> asyncio.Future[LoadReply]:
        reply: asyncio.Future[LoadReply] = asyncio.get_running_loop().create_future()
        self.loads.append((request, reply))
        return reply

    def unload_node(self, unique_id: int) -> asyncio.Future[UnloadReply]:
        self.unloaded.append(unique_id)
        if self.answers_unloads:
            self.nodes.pop(unique_id, None)
        return self._reply(self.answers_unloads, UnloadReply(success=True))

    def close(self) -> None:
        self.closed = True

    def construct(self, index: int = -1) -> None:
        """The load comes to a good end."""
        request, reply = self.loads[index]
        unique_id = len(self.loads) + 10
        name = f"/{request.node_name}"
        self.nodes[unique_id] = name
        reply.set_result(LoadReply(True, "", name, unique_id))

    def _reply(self, is_answered: bool, answer: Any) -> asyncio.Future[Any]:
        reply: asyncio.Future[Any] = asyncio.get_running_loop().create_future()
        if is_answered:
            reply.set_result(answer)
        else:
            self.unanswered.append(reply)
        return reply


def link_to(
    services: Services,
    *,
    name: str = "/box",
    slots: asyncio.Semaphore | None = None,
) -> StockLink:
    hello = Hello(
        version="",
        full_node_name=name,
        mode="stock",
        rmw_implementation="rmw_test",
        domain_id=7,
    )
    return StockLink(
        hello,
        services,
        slots=slots or asyncio.Semaphore(4),
        loading_timeout=10.0,
    )


async def greeted(services: Services, **keys: Any) -> StockLink:
    link = link_to(services, **keys)
    await link.handshake(Hello(version="1"))
    return link


def load(attempt: int, name: str) -> Load:
    return Load(attempt=attempt, package_name="demo", plugin_name="demo::Node", node_name=name)


async def ask(link: StockLink) -> Status:
    """What the actor asks after too long a silence; everything said before is dropped."""
    link.send(Query(query_id=99))
    return await status(link, 99)


async def status(link: StockLink, query_id: int) -> Status:
    while True:
        said: Incoming = await link.receive()
        if isinstance(said, Status) and said.query_id == query_id:
            return said
