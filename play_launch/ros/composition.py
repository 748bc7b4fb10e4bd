"""A client of one container's composition services: ListNodes, LoadNode, UnloadNode."""

from __future__ import annotations

import asyncio
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import anyio

from play_launch.ros.thread import RosThread, RosThreadError

if TYPE_CHECKING:
    from collections.abc import Callable

    from rclpy.node import Node

_AWAY: Final = 1.0
"""Seconds without its services after which a container is gone."""
_LISTS: Final = 8
"""Requests for a list that may be open: answers get lost, and a late one still counts."""
_LIST_INTERVALS: Final = (0.25, 3.0)
"""Seconds from one request for a list to the next: the first interval, which doubles, and the
longest."""


@dataclass(frozen=True, slots=True)
class LoadReply:
    """The answer to LoadNode; the number and name say something with `success` only."""

    success: bool
    error_message: str = ""
    full_node_name: str = ""
    unique_id: int = 0


@dataclass(frozen=True, slots=True)
class UnloadReply:
    """The answer to UnloadNode."""

    success: bool
    error_message: str = ""


class CompositionClient:
    """Talks to the container of a name; belongs to one event loop.

    Futures of requests stay open until there is an answer, possibly without end: an answer can
    be late by minutes and is still worth knowing.
    """

    def __init__(self, ros: RosThread, container: str) -> None:
        """Talk to the container with this full name; nothing is sent yet."""
        self._ros = ros
        self._name = container
        self._clients: dict[str, Any] = {}
        self._open: set[asyncio.Future[Any]] = set()
        self._closed = False
        ros.post(self._create)

    async def ready(self) -> None:
        """Wait until the services are there."""
        await self._ros.until(self._is_ready)

    async def gone(self) -> None:
        """Wait until they have left.

        They seem to be away for a moment, too, when another process of that name leaves the graph:
        20 s later if that was killed.
        """
        away = False
        while not away:
            await self._ros.until(lambda node: not self._is_ready(node))
            with anyio.move_on_after(_AWAY) as waiting:
                await self.ready()
            away = waiting.cancelled_caught

    async def is_ready(self) -> bool:
        """Whether the services are available now."""
        return await self._ros.call(self._is_ready)

    async def constructs_in_background(self) -> bool:
        """Whether it is known to answer while a constructor runs.

        Containers of play-launch do; they are known by a topic that rclcpp's do not have.
        """
        topic = f"{self._name}/_container/component_events"
        return await self._ros.call(lambda node: node.count_publishers(topic) > 0)

    async def all_nodes(self) -> dict[int, str]:
        """Request the full names by unique_id until there is an answer to this call.

        The services of a process that was just killed are still in the graph, and answers are
        dropped before both sides have discovered each other: so the request is repeated.
        """
        requests: deque[asyncio.Future[dict[int, str]]] = deque()
        interval, longest = _LIST_INTERVALS
        try:
            while not (done := [reply for reply in requests if reply.done()]):
                if len(requests) == _LISTS:
                    requests.popleft().cancel()
                requests.append(self.list_nodes())
                first = asyncio.FIRST_COMPLETED
                await asyncio.wait(requests, timeout=interval, return_when=first)
                interval = min(2 * interval, longest)
            return done[-1].result()
        finally:
            for reply in requests:
                reply.cancel()

    def list_nodes(self) -> asyncio.Future[dict[int, str]]:
        """Request the full names of all nodes by unique_id, once."""
        return self._request("list_nodes", lambda kind: kind.Request(), _listed)

    def load_node(self, request: Any) -> asyncio.Future[LoadReply]:
        """Send a ``composition_interfaces/LoadNode`` request."""
        return self._request("load_node", lambda _: request, _loaded)

    def unload_node(self, unique_id: int) -> asyncio.Future[UnloadReply]:
        """Ask for a node's end."""
        return self._request(
            "unload_node", lambda kind: kind.Request(unique_id=unique_id), _unloaded
        )

    def close(self) -> None:
        """End it; answers that are still expected are dropped."""
        if self._closed:
            return
        self._closed = True
        for future in tuple(self._open):
            future.cancel()
        self._ros.post(self._destroy)

    def _request(
        self, name: str, message: Callable[[Any], Any], read: Callable[[Any], Any]
    ) -> asyncio.Future[Any]:
        future = asyncio.ensure_future(self._answer(name, message, read))
        self._open.add(future)
        future.add_done_callback(self._open.discard)
        return future

    async def _answer(
        self, name: str, message: Callable[[Any], Any], read: Callable[[Any], Any]
    ) -> Any:
        # The other services have been waited for; where they are gone, the container is.
        if name == "unload_node":
            await self._ros.until(lambda node: self._client(node, name).service_is_ready())
        return read(await self._ros.request(lambda node: self._client(node, name), message))

    def _create(self, node: Node) -> None:
        # The client that asks first is made last: once a container answers it, it knows the other
        # as well. That for unloading is made when it is needed: each is discovered by all others.
        if not self._closed:
            for name in _NEEDED:
                self._client(node, name)

    def _client(self, node: Node, name: str) -> Any:
        # Takes long, so it is done in the thread.
        from composition_interfaces import srv  # noqa: PLC0415

        if self._closed:
            raise RosThreadError(f"the client of {self._name} is closed")
        if name not in self._clients:
            kind = getattr(srv, _SERVICES[name])
            self._clients[name] = node.create_client(kind, f"{self._name}/_container/{name}")
        return self._clients[name]

    def _is_ready(self, _: Node) -> bool:
        return not self._closed and all(self._clients[name].service_is_ready() for name in _NEEDED)

    def _destroy(self, node: Node) -> None:
        for client in self._clients.values():
            node.destroy_client(client)
        self._clients.clear()


_SERVICES: Final = {
    "load_node": "LoadNode",
    "unload_node": "UnloadNode",
    "list_nodes": "ListNodes",
}
_NEEDED: Final = ("load_node", "list_nodes")


def _listed(reply: Any) -> dict[int, str]:
    # Of two lists of different lengths no more than the shorter one can be used.
    pairs = zip(reply.unique_ids, reply.full_node_names, strict=False)
    return {int(unique_id): str(name) for unique_id, name in pairs}


def _loaded(reply: Any) -> LoadReply:
    return LoadReply(
        success=bool(reply.success),
        error_message=str(reply.error_message),
        full_node_name=str(reply.full_node_name),
        unique_id=int(reply.unique_id),
    )


def _unloaded(reply: Any) -> UnloadReply:
    return UnloadReply(success=bool(reply.success), error_message=str(reply.error_message))
