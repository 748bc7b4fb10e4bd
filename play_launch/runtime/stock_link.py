"""Translates between the messages of a control channel and ROS's composition services.

Such a container sends no events and constructs one node at a time, in the callback of the service.
So one load at a time is sent, and its answer is the result. Where that is overdue, the supervisor
queries the load, and ListNodes decides: a load that is not listed is unknown to the container, and
the supervisor sends it once more; not so where constructors are known to run in the background.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final, assert_never

import anyio
from msgspec.structs import replace

from play_launch.container import messages as m
from play_launch.container.channel import ChannelClosedError
from play_launch.container.codec import ControlError, EncodeError
from play_launch.ros.parameters import to_parameter_message
from play_launch.ros.thread import RosThreadError
from play_launch.supervisor.events import ComponentEvent, ComponentEventKind

if TYPE_CHECKING:
    from collections.abc import Coroutine

    from play_launch.ros.composition import CompositionClient

_log = logging.getLogger(__name__)

_LIST_TIMEOUT: Final = 3.0
"""Seconds after which a container answers nothing for now."""
_UNLOAD_TIMEOUT: Final = 10.0
_CHECK_INTERVAL: Final = 5.0
"""Seconds between two comparisons with the list while nothing is loaded."""
_SILENCE: Final = 10.0
"""Seconds after which a container that loads nothing and does not answer is reported."""
_UNLOADS: Final = 2
"""Requests to unload a node when a container is detached."""


@dataclass(slots=True, eq=False)
class StockLoad:
    """One attempt to load a node; ``request`` is that of the service."""

    message: m.Load
    request: object
    state: m.NodeStatusState = m.NodeStatusState.QUEUED
    unique_id: int = 0
    full_name: str = ""
    before: frozenset[int] = frozenset()
    """Nodes that existed when it was sent."""
    sent_at: float = 0.0
    reply: asyncio.Future[Any] = field(default_factory=asyncio.Future)
    """Answer to LoadNode; cancelled when ListNodes has decided."""

    @property
    def declared_name(self) -> str:
        """Full name by its declaration; empty where the component chooses."""
        name = self.message.node_name
        return f"{self.message.node_namespace.rstrip('/')}/{name}" if name else ""

    @property
    def label(self) -> str:
        return self.full_name or self.declared_name or self.message.plugin_name


class StockLink:
    """Represents the control channel of one container process, from its start to its exit."""

    def __init__(
        self,
        hello: m.Hello,
        services: CompositionClient,
        *,
        slots: asyncio.Semaphore,
        loading_timeout: float,
    ) -> None:
        """``hello`` describes the container, whose pid is 0 where it is unknown.

        ``slots`` bounds how many containers load a node at the same time; a container frees its
        slot when a load is not answered for ``loading_timeout`` seconds.
        """
        self.services = services
        self._container = hello
        self._name = hello.full_node_name
        self._slots = slots
        self._timeout = loading_timeout
        self._loop = asyncio.get_running_loop()
        self._loads: dict[int, StockLoad] = {}
        """By attempt: all that wait, run, or have a node."""
        self._queue: asyncio.Queue[StockLoad] = asyncio.Queue()
        self._current: StockLoad | None = None
        """The load that was sent and has no result yet."""
        self._is_serial = True
        self._is_stopping = False
        self._incoming: asyncio.Queue[m.Incoming | ControlError] = asyncio.Queue()
        self._tasks: set[asyncio.Task[None]] = set()
        self._listed: dict[int, str] = {}
        """The latest list of nodes."""
        self._answered_at = 0.0
        self._is_silent = False
        self._changed = asyncio.Event()
        """Set when a load changed its state."""
        self.ended = asyncio.Event()
        self.end_reason = ""

    # The control channel.

    async def handshake(self, hello: m.Hello) -> m.Hello:
        """Wait until the container answers; ROS transmits no hello of the supervisor.

        Raises:
            ControlError: When the supervisor has no ROS node.
        """
        del hello
        try:
            await self.services.ready()
            nodes = await self._list()
            self._is_serial = not await self.services.constructs_in_background()
        except RosThreadError as error:
            raise ControlError(str(error)) from error
        if not self._container.pid:
            self.start(self._watch_services())
        self.start(self._work())
        self.start(self._check_periodically())
        notes = (f"{len(nodes)} node(s) existed already",) if nodes else ()
        return replace(self._container, notes=notes)

    async def receive(self) -> m.Incoming:
        """Wait for the next message; after an error, each call raises it."""
        message = await self._incoming.get()
        if isinstance(message, ControlError):
            self._incoming.put_nowait(message)
            raise message
        return message

    def send(self, message: m.Outgoing) -> None:
        """Accept a request; raises ControlError, and EncodeError for a load that cannot be sent."""
        match message:
            case m.Load():
                load = StockLoad(message, load_node_request(message))
                self._loads[message.attempt] = load
                self._queue.put_nowait(load)
            case m.Query(unique_ids=ids) if ids == m.NO_NODE:
                # Answered by the link: a silent container is no reason to kill it.
                self._report(m.Status(query_id=message.query_id))
            case m.Query():
                self.start(self._answer(message))
            case m.Unload():
                self._unload(message.unique_id)
            case m.Shutdown():
                self._is_stopping = True
                raise ControlError("a stock container is stopped by a signal")
            case m.Cancel() | m.Hello():
                pass  # a constructor cannot be cancelled; its node is unloaded once it is loaded
            case _:
                assert_never(message)

    def close(self) -> None:
        """Cancel all requests; the container does not notice."""
        for task in self._tasks:
            task.cancel()
        self.services.close()

    def start(self, work: Coroutine[Any, Any, None]) -> None:
        """Run a task up to `close`; its failure is that of the channel."""
        task = self._loop.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._finished)

    def _finished(self, task: asyncio.Task[None]) -> None:
        self._tasks.discard(task)
        if not task.cancelled() and (error := task.exception()) is not None:
            _log.error("%s: %s", self._name, error, exc_info=error)
            self._incoming.put_nowait(ControlError(f"requests to the container failed: {error}"))

    def end(self, reason: str, *, in_order: bool = False) -> None:
        """Report that the container exited; ``in_order``: as it was requested to."""
        if self.ended.is_set():
            return
        self.end_reason = reason
        self.ended.set()
        if in_order and self._is_stopping:
            for load in self._loaded():
                self._unloaded(load, "with its container")
        self._incoming.put_nowait(ChannelClosedError(reason))

    async def unload_all(self) -> None:
        """Load nothing more and unload what was loaded through this link."""
        self._is_stopping = True
        requests: Counter[int] = Counter()
        while self.unfinished():
            self._changed.clear()
            for load in self._loaded():
                if requests[load.unique_id] < _UNLOADS:
                    requests[load.unique_id] += 1
                    self._unload(load.unique_id)
            await self._changed.wait()

    def unfinished(self) -> list[StockLoad]:
        """Return the loads that were sent and whose nodes are not unloaded."""
        return [load for load in self._loads.values() if load.state is not m.NodeStatusState.QUEUED]

    # Loading.

    async def _work(self) -> None:
        while True:
            load = await self._queue.get()
            await self.services.ready()
            if not await self._has_name_conflict(load):
                await self._load(load)

    async def _has_name_conflict(self, load: StockLoad) -> bool:
        name = load.declared_name
        if not name or name not in self._listed.values():
            return False
        found = [each for each, listed in (await self._list()).items() if listed == name]
        if found:
            which = f"unique_id {found[0]}"
            self._failed(load, f"the container has a node of that name already ({which})")
        return bool(found)

    async def _load(self, load: StockLoad) -> None:
        async with self._slots:
            if self._is_stopping:
                return
            load.reply = reply = self.services.load_node(load.request)
            self._current = load
            load.sent_at, load.before = self._loop.time(), frozenset(self._listed)
            self._set_state(load, m.NodeStatusState.CONSTRUCTING)
            self._report(self._event(ComponentEventKind.LOADING, load))
            # A constructor that takes longer keeps no other container waiting.
            await asyncio.wait({reply}, timeout=self._timeout)
        await asyncio.wait({reply})
        if reply.cancelled():
            return
        self._current = None
        answer = reply.result()
        self._has_answered()
        if answer.success:
            self._listed[answer.unique_id] = answer.full_node_name
            is_renamed = load.declared_name not in {"", answer.full_node_name}
            remark = f"it calls itself {answer.full_node_name}" if is_renamed else ""
            self._is_loaded(load, answer.unique_id, remark)
        else:
            self._failed(load, answer.error_message or "the container gave no reason")

    async def _answer(self, query: m.Query) -> None:
        """Answer a query; where the answer to a load is overdue, ListNodes decides first."""
        load, note = self._current, ""
        if load is not None and load.sent_at <= self._loop.time() - self._timeout:
            with anyio.move_on_after(_LIST_TIMEOUT) as scope:
                listed = await self._list()
                if self._current is load:
                    self._decide_overdue(load, listed)
            does = "answers nothing" if scope.cancelled_caught else "lists other nodes only"
            pid = f" (pid {self._container.pid})" if self._container.pid else ""
            note = f"LoadNode was sent and is not answered; the container{pid} {does} meanwhile"
        nodes = tuple(
            self._status(each, note if each is load else "") for each in self._loads.values()
        )
        self._report(m.Status(query_id=query.query_id, nodes=nodes))

    def _decide_overdue(self, load: StockLoad, listed: dict[int, str]) -> None:
        """Find the new node of its name, or, without a name, the only new one."""
        known = load.before | {each.unique_id for each in self._loads.values()}
        namespace, declared = f"{load.message.node_namespace.rstrip('/')}/", load.declared_name
        found = [
            unique_id
            for unique_id, name in sorted(listed.items())
            if unique_id not in known
            and (name == declared if declared else name.startswith(namespace))
        ]
        is_found = bool(found) if declared else len(found) == 1
        if not (is_found or self._is_serial):
            return  # its constructor may run in the background
        self._current = None
        load.reply.cancel()
        if is_found:
            remark = "LoadNode was not answered, but the container lists the node"
            self._is_loaded(load, found[0], remark, confirmed_by="list_nodes")
        else:
            self._forget(load)

    # Unloading.

    def _unload(self, unique_id: int) -> None:
        for load in self._loaded():
            if load.unique_id == unique_id:
                self._set_state(load, m.NodeStatusState.UNLOADING)
                self.start(self._unload_load(load))
                return
        self._report(m.Rejected(attempt=0, unique_id=unique_id, reason="no such node"))

    async def _unload_load(self, load: StockLoad) -> None:
        await self.services.ready()
        reply = self.services.unload_node(load.unique_id)
        reason = f"no answer within {_UNLOAD_TIMEOUT:g} s"
        if (await asyncio.wait({reply}, timeout=_UNLOAD_TIMEOUT))[0]:
            self._has_answered()
            answer = reply.result()
            reason = "" if answer.success else answer.error_message or "no reason given"
        reply.cancel()
        exists = bool(reason) and load.unique_id in await self._list()
        if load.state is not m.NodeStatusState.UNLOADING:
            return
        if exists:
            _log.warning("%s: %s is not unloaded: %s", self._name, load.label, reason)
            self._set_state(load, m.NodeStatusState.LOADED)
            self._report(m.Rejected(attempt=0, unique_id=load.unique_id, reason=reason))
        else:
            self._unloaded(load, "")

    # The container.

    async def _list(self) -> dict[int, str]:
        self._listed = await self.services.all_nodes()
        self._has_answered()
        return self._listed

    def _has_answered(self) -> None:
        self._answered_at = self._loop.time()
        if self._is_silent:
            self._is_silent = False
            _log.warning("%s answers again", self._name)

    async def _watch_services(self) -> None:
        await self.services.gone()
        self.end("it is gone: its services left the graph")

    async def _check_periodically(self) -> None:
        """Detect nodes that are gone, and a container that is silent or was restarted."""
        while True:
            await asyncio.sleep(_CHECK_INTERVAL)
            if self._current is not None:
                continue
            loaded = self._loaded()
            with anyio.move_on_after(_LIST_TIMEOUT) as scope:
                await self._list()
            if scope.cancelled_caught:
                silent = self._loop.time() - self._answered_at
                if silent > _SILENCE and not self._is_silent and self._current is None:
                    self._is_silent = True
                    text = "%s has not answered for %.0f s: its executor is busy, or it is frozen"
                    _log.warning(text, self._name, silent)
                continue
            gone = [
                load
                for load in loaded
                if load.state is m.NodeStatusState.LOADED
                and self._listed.get(load.unique_id) != load.full_name
            ]
            if gone and gone == loaded and not self._container.pid:
                self.end("it was restarted: it lists none of its nodes")
                return
            for load in gone:
                self._unloaded(load, "another program unloaded it: it is no longer listed")

    def _loaded(self) -> list[StockLoad]:
        return [load for load in self._loads.values() if load.state is m.NodeStatusState.LOADED]

    def _set_state(self, load: StockLoad, state: m.NodeStatusState) -> None:
        load.state = state
        self._changed.set()

    def _forget(self, load: StockLoad) -> None:
        self._loads.pop(load.message.attempt, None)
        self._changed.set()

    def _is_loaded(
        self, load: StockLoad, unique_id: int, remark: str, *, confirmed_by: str = ""
    ) -> None:
        load.unique_id, load.full_name = unique_id, self._listed[unique_id]
        self._set_state(load, m.NodeStatusState.LOADED)
        self._report(self._event(ComponentEventKind.LOADED, load, remark, confirmed_by))

    def _failed(self, load: StockLoad, reason: str) -> None:
        self._forget(load)
        self._report(self._event(ComponentEventKind.LOAD_FAILED, load, reason))

    def _unloaded(self, load: StockLoad, reason: str) -> None:
        self._listed.pop(load.unique_id, None)
        self._report(self._event(ComponentEventKind.UNLOADED, load, reason))
        self._forget(load)

    def _status(self, load: StockLoad, note: str) -> m.NodeStatus:
        elapsed = self._loop.time() - load.sent_at if load.sent_at else 0.0
        state = load.state
        if load is self._current and not note:  # it is not overdue, which is no news
            state = m.NodeStatusState.QUEUED
        return m.NodeStatus(
            unique_id=load.unique_id,
            attempt=load.message.attempt,
            state=state,
            full_node_name=load.full_name,
            pid=self._container.pid,
            start_time=self._container.start_time,
            elapsed_ns=round(elapsed * 1e9),
            note=note,
        )

    def _event(
        self, kind: ComponentEventKind, load: StockLoad, text: str = "", confirmed_by: str = ""
    ) -> ComponentEvent:
        return ComponentEvent(
            stamp_ns=time.time_ns(),
            kind=kind,
            container=self._name,
            unique_id=load.unique_id,
            attempt=load.message.attempt,
            full_node_name=load.full_name,
            package_name=load.message.package_name,
            plugin_name=load.message.plugin_name,
            error_message=text,
            confirmed_by=confirmed_by,
            pid=self._container.pid,
            start_time=self._container.start_time,
        )

    def _report(self, message: m.Incoming) -> None:
        self._incoming.put_nowait(message)


def load_node_request(load: m.Load) -> Any:
    """Make a ``composition_interfaces/LoadNode`` request.

    Raises:
        EncodeError: When a value does not fit.
    """
    # Takes long; imported before by `StockContainers`.
    from composition_interfaces.srv import LoadNode  # noqa: PLC0415

    request = LoadNode.Request(check_fields=True)
    try:
        request.package_name = load.package_name
        request.plugin_name = load.plugin_name
        request.node_name = load.node_name
        request.node_namespace = load.node_namespace
        request.log_level = load.log_level
        request.remap_rules = list(load.remap_rules)
        request.parameters = [to_parameter_message(each) for each in load.parameters]
        request.extra_arguments = [to_parameter_message(each) for each in load.extra_arguments]
    except (AssertionError, TypeError, ValueError) as error:
        raise EncodeError(load, error) from error
    return request
