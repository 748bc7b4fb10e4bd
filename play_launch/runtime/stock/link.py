"""Translates between the messages of a control channel and ROS's composition services.

A container of rclcpp_components sends no events and constructs one node at a time, in the callback
of the service. So one load at a time is sent. Its answer counts once ListNodes agrees; ListNodes is
asked as well when there is no answer. A load that is neither answered nor listed is unknown to the
container, and the supervisor may send it anew; not so where the container is known to construct in
the background.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections import Counter
from typing import TYPE_CHECKING, Any, Final, assert_never

from msgspec.structs import replace

from play_launch.container.channel import ChannelClosedError, ControlError
from play_launch.container.messages import (
    NO_NODE,
    Cancel,
    Hello,
    Incoming,
    Load,
    NodeStatusState,
    Outgoing,
    Query,
    Rejected,
    Shutdown,
    Status,
    Unload,
)
from play_launch.ros.thread import RosThreadError
from play_launch.runtime.stock.conversation import Conversation, StockLimits
from play_launch.runtime.stock.loads import StockLoad, cpu_time_ns, load_node_request
from play_launch.supervisor.events import ComponentEvent, ComponentEventKind

if TYPE_CHECKING:
    from collections.abc import Coroutine

    from play_launch.ros.composition import CompositionClient, LoadReply

_log = logging.getLogger(__name__)

_UNLOADS: Final = 2
"""Tries to unload a node when a container is detached."""


class StockLink:
    """Talks to one container process, from its start to its end."""

    def __init__(
        self,
        hello: Hello,
        services: CompositionClient,
        *,
        places: asyncio.Semaphore,
        loading_timeout: float,
        limits: StockLimits | None = None,
    ) -> None:
        """Send nothing yet; ``hello`` describes the container, whose pid is 0 where it is unknown.

        ``places`` bounds how many containers load a node at the same time; a load is silent after
        ``loading_timeout`` seconds.
        """
        self._container = hello
        self._name = hello.full_node_name
        self.talk = Conversation(self._name, services, limits or StockLimits())
        self._places = places
        self._timeout = loading_timeout
        self._loop = asyncio.get_running_loop()
        self._loads: dict[int, StockLoad] = {}
        """By attempt: all that wait, run, or have a node."""
        self._queue: asyncio.Queue[StockLoad] = asyncio.Queue()
        self._current: StockLoad | None = None
        self._lost: set[str] = set()
        """Names of nodes whose LoadNode was lost and which may still appear."""
        self._surplus: set[int] = set()
        """Nodes of lost loads that came too late."""
        self._servers: frozenset[bytes] = frozenset()
        self._is_serial = True
        self._is_stopping = False
        self._said: asyncio.Queue[Incoming | ControlError] = asyncio.Queue()
        self._tasks: set[asyncio.Task[None]] = set()
        self._changed = asyncio.Event()
        self.ended = asyncio.Event()
        self.end_reason = ""

    # The control channel.

    async def handshake(self, hello: Hello) -> Hello:
        """Wait until the container answers; ROS has no place for the supervisor's own hello.

        Raises:
            ControlError: When there is no way to ask it.
        """
        del hello
        try:
            await self.talk.services.ready()
            nodes = await self.talk.list()
            self._is_serial = not await self.talk.services.constructs_in_background()
            self._servers = await self.talk.services.servers()
        except RosThreadError as error:
            raise ControlError(str(error)) from error
        if not self._container.pid:
            self.start(self._watch_services())
        self.start(self._work())
        self.start(self._look_now_and_then())
        notes = (f"{len(nodes)} node(s) were there already",) if nodes else ()
        return replace(self._container, notes=notes)

    async def receive(self) -> Incoming:
        """Wait for the next message."""
        said = await self._said.get()
        if isinstance(said, ControlError):
            self._said.put_nowait(said)
            raise said
        return said

    def send(self, message: Outgoing) -> None:
        """Take a request; raises ControlError, and EncodeError for a load that cannot be sent."""
        match message:
            case Load():
                load = StockLoad(message, load_node_request(message))
                self._loads[message.attempt] = load
                self._queue.put_nowait(load)
            case Query(unique_ids=ids) if ids == NO_NODE:
                # Whether we live is asked. Silence of the container is no reason to kill it.
                self._say(Status(query_id=message.query_id))
            case Query():
                self.start(self._answer(message))
            case Unload():
                self._unload(message.unique_id)
            case Shutdown():
                self._is_stopping = True
                raise ControlError("a stock container is asked to end by a signal")
            case Cancel() | Hello():
                pass  # a constructor cannot be cancelled; its node is unloaded when it is there
            case _:
                assert_never(message)

    def close(self) -> None:
        """End the conversation; the container does not notice."""
        for task in self._tasks:
            task.cancel()
        self.talk.services.close()

    # For what starts it.

    def start(self, work: Coroutine[Any, Any, None]) -> None:
        """Run a task up to `close`; its failure is that of the channel."""
        task = self._loop.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._finished)

    def _finished(self, task: asyncio.Task[None]) -> None:
        self._tasks.discard(task)
        if not task.cancelled() and (error := task.exception()) is not None:
            _log.error("%s: %s", self._name, error, exc_info=error)
            self._said.put_nowait(ControlError(f"the conversation has failed: {error}"))

    def end(self, reason: str, *, in_order: bool = False) -> None:
        """Report that the container is gone; ``in_order``: it ended as it should when asked to."""
        if self.ended.is_set():
            return
        self.end_reason = reason
        self.ended.set()
        if in_order and self._is_stopping:
            for load in self._loaded():
                self._unloaded(load, "with its container")
        self._said.put_nowait(ChannelClosedError(reason))

    async def unload_all(self) -> None:
        """Load nothing more and unload what was loaded through this link."""
        self._is_stopping = True
        asked: Counter[int] = Counter()
        while self.unfinished():
            self._changed.clear()
            for load in self._loaded():
                if asked[load.unique_id] < _UNLOADS:
                    asked[load.unique_id] += 1
                    self._unload(load.unique_id)
            await self._changed.wait()

    def unfinished(self) -> list[StockLoad]:
        """Return what is in the container, or on its way to it or out of it."""
        return [load for load in self._loads.values() if load.state is not NodeStatusState.QUEUED]

    # Loading.

    async def _work(self) -> None:
        while True:
            load = await self._queue.get()
            self._current = load
            self.start(self._load(load))
            await load.turn_over.wait()
            self._current = None

    async def _load(self, load: StockLoad) -> None:
        try:
            await self.talk.services.ready()
            if await self._is_settled_before(load):
                return
            async with self._places:
                if self._is_stopping:
                    return
                reply = self.talk.services.load_node(load.request)
                load.sent_at, load.before = self._loop.time(), frozenset(self.talk.listed)
                load.cpu_time_ns = cpu_time_ns(self._container.pid)
                self._enter(load, NodeStatusState.CONSTRUCTING)
                self._say(self._event(ComponentEventKind.LOADING, load))
                # A constructor that takes longer keeps no other container waiting.
                await asyncio.wait({reply}, timeout=self._timeout)
            answer = await reply
            self.talk.heard()
            if load.is_silent:
                await self._confirm(load, answer)
            elif load.state is None and not load.unique_id and answer.success:
                await self._drop(load, answer.unique_id)
        finally:
            load.turn_over.set()

    async def _is_settled_before(self, load: StockLoad) -> bool:
        """Look whether the container has a node of that name already."""
        name = load.declared_name
        if not name or not (name in self._lost or self._find(name)):
            return False
        await self.talk.list()
        there = self._find(name)
        if there and name in self._lost:
            self._is_loaded(load, there[0], "list_nodes", "its first LoadNode was not answered")
        elif there:
            which = f"unique_id {there[0]}"
            self._failed(load, f"the container has a node of that name already ({which})")
        return bool(there)

    async def _confirm(self, load: StockLoad, answer: LoadReply) -> None:
        """Compare the answer with a list that was made after it."""
        load.is_answered = True
        listed = await self.talk.list()
        claimed, named = answer.unique_id, answer.full_node_name
        why = answer.error_message or "the container does not say why"
        if answer.success:
            why = "the container said that it is loaded, and does not list it"
        load.full_name = named
        listed_as = listed.get(claimed) if claimed not in self._others(load) else None
        if answer.success and listed_as and (load.is_called(listed_as) or listed_as == named):
            renamed = "" if load.is_called(listed_as) else f"it calls itself {listed_as}"
            self._is_loaded(load, claimed, "", renamed)
        elif found := load.find(listed, self._others(load)):
            said = f"its unique_id is {claimed}" if answer.success else f"it failed ({why})"
            remark = f"the container said that {said}, but lists {found[0]}"
            self._is_loaded(load, found[0], "list_nodes", remark)
        else:
            self._failed(load, why)

    async def _answer(self, query: Query) -> None:
        """Answer a query; where a load has been silent for too long, the list decides first."""
        oldest = self._loop.time() - self._timeout
        silent = [each for each in self._loads.values() if each.is_silent]
        overdue = [load for load in silent if load.sent_at <= oldest]
        listed = await self.talk.list_in_time() if overdue else None
        for load in overdue:
            if listed is not None and load.is_silent:
                self._judge_silent(load, listed)
        now = self._loop.time()
        nodes = tuple(load.status(self._container, now) for load in self._loads.values())
        self._say(Status(query_id=query.query_id, nodes=nodes))

    def _judge_silent(self, load: StockLoad, listed: dict[int, str]) -> None:
        load.container_answers = True
        load.turn_over.set()
        is_certain = load.declared_name or sum(each.is_silent for each in self._loads.values()) == 1
        if is_certain and (found := load.find(listed, self._others(load))):
            remark = "LoadNode was not answered, but the container lists it"
            self._is_loaded(load, found[0], "list_nodes", remark)
        elif self._is_serial:
            # It answers, so nothing is under construction.
            self._lost.add(load.declared_name)
            self._leave(load)

    async def _drop(self, load: StockLoad, unique_id: int) -> None:
        """Unload the node of a lost load, unless a later load has taken it."""
        if unique_id not in self._others(load):
            _log.warning("%s: node %d came of a lost LoadNode; unloaded", self._name, unique_id)
            self._surplus.add(unique_id)
            await self.talk.unload(unique_id)

    # Unloading.

    def _unload(self, unique_id: int) -> None:
        for load in self._loads.values():
            if load.is_there and load.unique_id == unique_id:
                self._enter(load, NodeStatusState.UNLOADING)
                self.start(self._unload_load(load))
                return
        self._say(Rejected(attempt=0, unique_id=unique_id, reason="there is no such node"))

    async def _unload_load(self, load: StockLoad) -> None:
        reason = await self.talk.unload(load.unique_id)
        is_there = bool(reason) and load.unique_id in await self.talk.list()
        if load.state is not NodeStatusState.UNLOADING:
            return
        if is_there:
            self._enter(load, NodeStatusState.LOADED)
            self._say(Rejected(attempt=0, unique_id=load.unique_id, reason=reason))
        else:
            self._unloaded(load, "")

    # The container.

    async def _watch_services(self) -> None:
        await self.talk.services.gone()
        self.end("it is gone: its services are not in the graph any more")

    async def _look_now_and_then(self) -> None:
        doubled_at = self._loop.time() + self.talk.limits.lease
        while True:
            await asyncio.sleep(self.talk.limits.look)
            if self._current is None:
                await self._look()
            if self._loop.time() > doubled_at:
                number = len(await self.talk.services.servers())
                if number > 1:
                    doubled_at = float("inf")
                    text = "%d containers are called %s: each of them gets every request"
                    _log.warning(text, number, self._name)

    async def _look(self) -> None:
        """Notice nodes that are gone, and a container that is silent, or was started anew."""
        loaded = self._loaded()
        listed = await self.talk.list_in_time()
        if listed is None:
            if self._current is None:
                self.talk.report_silence()
            return
        gone = [
            load
            for load in loaded
            if load.state is NodeStatusState.LOADED and listed.get(load.unique_id) != load.full_name
        ]
        is_theirs = not self._container.pid
        if (
            is_theirs
            and gone
            and gone == loaded
            and await self.talk.services.servers() - self._servers
        ):
            self.end("it was started anew: it has none of the nodes that it had")
            return
        for load in gone:
            self._unloaded(load, "the container does not list it any more; we did not unload it")

    # What is known.

    def _loaded(self) -> list[StockLoad]:
        return [load for load in self._loads.values() if load.state is NodeStatusState.LOADED]

    def _others(self, load: StockLoad | None = None) -> set[int]:
        """Return the nodes of other loads."""
        ours = {each.unique_id for each in self._loads.values() if each.is_there and each != load}
        return ours | self._surplus

    def _find(self, name: str) -> list[int]:
        others, listed = self._others(), self.talk.listed
        return [each for each in listed if listed[each] == name and each not in others]

    def _enter(self, load: StockLoad, state: NodeStatusState | None) -> None:
        load.state = state
        self._changed.set()

    def _leave(self, load: StockLoad) -> None:
        self._loads.pop(load.message.attempt, None)
        self._enter(load, None)

    def _is_loaded(self, load: StockLoad, unique_id: int, by: str, remark: str) -> None:
        load.unique_id, load.full_name = unique_id, self.talk.listed[unique_id]
        self._lost.discard(load.declared_name)
        self._enter(load, NodeStatusState.LOADED)
        if others := [each for each in self._find(load.full_name) if each != unique_id]:
            same = f"other nodes have that name as well: unique_id {', '.join(map(str, others))}"
            remark = f"{remark}; {same}" if remark else same
        self._say(self._event(ComponentEventKind.LOADED, load, remark, by))

    def _failed(self, load: StockLoad, reason: str) -> None:
        self._lost.discard(load.declared_name)
        self._leave(load)
        self._say(self._event(ComponentEventKind.LOAD_FAILED, load, reason))

    def _unloaded(self, load: StockLoad, reason: str) -> None:
        self.talk.listed.pop(load.unique_id, None)
        self._say(self._event(ComponentEventKind.UNLOADED, load, reason))
        self._leave(load)

    def _event(
        self, kind: ComponentEventKind, load: StockLoad, text: str = "", confirmed_by: str = ""
    ) -> ComponentEvent:
        return ComponentEvent(
            stamp_ns=time.time_ns(),
            kind=kind,
            container=self._name,
            unique_id=load.unique_id,
            attempt=load.message.attempt,
            full_node_name=load.full_name if load.is_there else "",
            package_name=load.message.package_name,
            plugin_name=load.message.plugin_name,
            error_message=text,
            confirmed_by=confirmed_by,
            pid=self._container.pid,
            start_time=self._container.start_time,
        )

    def _say(self, message: Incoming) -> None:
        self._said.put_nowait(message)
