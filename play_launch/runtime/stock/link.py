"""The dialogue with a container that only has ROS's composition services.

To the container's actor it is a control channel like any other: it says hello, takes loads, reports
events and answers questions. What the container's answers mean is decided in
:mod:`play_launch.runtime.stock.composition`; here requests are sent and waited for.
"""

from __future__ import annotations

import asyncio
import logging
from collections import Counter
from typing import TYPE_CHECKING, Any, assert_never

from play_launch.ros.thread import RosThreadError
from play_launch.runtime.stock.asking import Silence, first_list
from play_launch.runtime.stock.composition import Composition
from play_launch.runtime.stock.composition_words import (
    Action,
    AskList,
    Remark,
    ReportFailed,
    ReportLoaded,
    ReportRejected,
    ReportUnloaded,
    SendLoad,
    SendUnload,
    Stage,
    Wanted,
)
from play_launch.runtime.stock.ports import STOCK_LIMITS, StockLimits
from play_launch.runtime.stock.reports import ContainerIdentity, Request, StockReports
from play_launch.supervisor.events import ComponentEventKind
from play_launch.wire.channel import ChannelClosedError, ControlError
from play_launch.wire.messages import (
    NO_NODE,
    Cancel,
    Hello,
    Incoming,
    Load,
    Outgoing,
    Query,
    Rejected,
    Shutdown,
    Status,
    Unload,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine

    from play_launch.ros.composition import ListedNode, LoadReply
    from play_launch.runtime.stock.ports import CompositionServices

_log = logging.getLogger(__name__)

_UNLOADS = 2
"""How often a node is asked to go when a container is let go."""


class CannotBeAskedError(ControlError):
    """There is no service by which a container can be asked to end."""


class StockLink:
    """Speaks for one container process, from its start to its end."""

    def __init__(
        self,
        container: ContainerIdentity,
        services: CompositionServices,
        *,
        hello: Hello,
        encode: Callable[[Load], object],
        places: asyncio.Semaphore,
        loading_timeout: float,
        limits: StockLimits = STOCK_LIMITS,
    ) -> None:
        """Say nothing yet.

        Args:
            container: Whom it is about.
            services: The way to it.
            hello: What to say in its name; completed with what is found.
            encode: Makes the request for a load; raises what `send` may raise.
            places: Bounds how many containers load a node at the same time.
            loading_timeout: Seconds after which a silent load is looked for in the list.
            limits: Other times.
        """
        self._name = container.name
        self._services = services
        self._hello = hello
        self._encode = encode
        self._places = places
        self._timeout = loading_timeout
        self._limits = limits
        self._loop = asyncio.get_running_loop()
        self._reports = StockReports(container, self._loop.time)
        self._composition = Composition()
        self._requests: dict[int, Request] = {}
        self._questions: list[Query] = []
        self._said: asyncio.Queue[Incoming | ControlError] = asyncio.Queue()
        self._tasks: set[asyncio.Task[None]] = set()
        self._late_list: asyncio.Future[Any] | None = None
        self._changed = asyncio.Event()
        self._silence = Silence(container.name, limits.silence, self._loop.time)
        self._is_closed = False
        self.is_greeted = False
        self.on_list: Callable[[tuple[ListedNode, ...]], None] = lambda _: None
        """Called with every list before anything is concluded from it."""

    @property
    def composition(self) -> Composition:
        """What is known about the container's nodes."""
        return self._composition

    async def handshake(self, hello: Hello) -> Hello:
        """Wait until the container answers; the supervisor's own hello has no place in ROS.

        Raises:
            ControlError: When there is no way to ask it.
        """
        del hello
        try:
            return await self._ask_for_hello()
        except RosThreadError as error:
            raise ControlError(str(error)) from error

    async def _ask_for_hello(self) -> Hello:
        await self._services.ready()
        nodes = await first_list(self._services, self._limits)
        self._composition.serially = not await self._services.constructs_in_background()
        self._composition.begin(nodes)
        self._silence.heard()
        self.is_greeted = True
        self._start(self._look_now_and_then())
        there = f"{len(nodes)} node(s) were there already"
        return Hello(
            version=self._hello.version,
            pid=self._reports.container.pid,
            start_time=self._reports.container.start_time,
            full_node_name=self._name,
            mode="stock",
            rmw_implementation=self._hello.rmw_implementation,
            domain_id=self._hello.domain_id,
            notes=(there,) if nodes else (),
        )

    async def receive(self) -> Incoming:
        """Wait for the next word in the container's name."""
        said = await self._said.get()
        if isinstance(said, ControlError):
            self._said.put_nowait(said)
            raise said
        return said

    def send(self, message: Outgoing) -> None:
        """Take a request; raises ControlError, and EncodeError for a load that cannot be sent."""
        if self._is_closed:
            raise ChannelClosedError("the dialogue with the container is over")
        match message:
            case Load():
                self._requests[message.attempt] = Request(message, self._encode(message))
                self._do(self._composition.load(message.attempt, _wanted(message)))
            case Query(unique_ids=ids) if ids == NO_NODE:
                # It asks whether we live. Silence of the container is no reason to kill it.
                self._say(Status(query_id=message.query_id))
            case Query():
                self._questions.append(message)
                self._do(self._composition.ask_about(self._overdue()))
            case Unload():
                self._do(self._composition.unload(message.unique_id))
            case Shutdown():
                self._composition.stop()
                raise CannotBeAskedError("a stock container is asked to end by a signal")
            case Cancel() | Hello():
                # A constructor cannot be cancelled; what it makes is unloaded when it is there.
                pass
            case _:
                assert_never(message)

    def end(self, reason: str, *, in_order: bool) -> None:
        """The container is gone; ``in_order`` is whether it ended as it should when asked to."""
        if in_order and self._composition.is_stopping:
            for record in self._composition.loaded():
                self._report_unloaded(
                    record.attempt, record.unique_id, record.full_name, "with its container"
                )
        self._said.put_nowait(ChannelClosedError(reason))

    async def unload_all(self) -> None:
        """Load nothing more and unload what was loaded by us; what had been there stays."""
        self._composition.stop()
        asked: Counter[int] = Counter()
        while True:
            changed = self._changed
            for record in self._composition.loaded():
                asked[record.unique_id] += not record.adopted
                if not record.adopted and asked[record.unique_id] <= _UNLOADS:
                    self._do(self._composition.unload(record.unique_id))
            if not self._composition.unfinished():
                return
            await changed.wait()

    def close(self) -> None:
        """End the dialogue; the container does not notice."""
        self._is_closed = True
        for task in self._tasks:
            task.cancel()
        self._services.close()

    def look(self) -> None:
        """Compare what is known with the container's list, now."""
        if self.is_greeted and not self._is_closed:
            self._do(self._composition.look())

    def _overdue(self) -> list[int]:
        """The attempts that have been silent for as long as silence is just silence."""
        return [attempt for attempt, request in self._requests.items() if self._is_overdue(request)]

    def _is_overdue(self, request: Request) -> bool:
        return (
            request.served_since is not None
            and self._loop.time() - request.served_since >= self._timeout
        )

    def _do(self, actions: list[Action]) -> None:
        changed, self._changed = self._changed, asyncio.Event()
        changed.set()
        for action in actions:
            match action:
                case SendLoad(attempt):
                    self._start(self._load(attempt))
                case SendUnload(unique_id):
                    self._start(self._unload(unique_id))
                case AskList(serial, delay):
                    self._start(self._list(serial, delay))
                case ReportLoaded():
                    self._report_loaded(action)
                case ReportFailed(attempt, reason):
                    load = self._requests.pop(attempt).load
                    self._say(
                        self._reports.event(ComponentEventKind.LOAD_FAILED, load, message=reason)
                    )
                case ReportUnloaded(attempt, unique_id, full_name, reason):
                    self._report_unloaded(attempt, unique_id, full_name, reason)
                case ReportRejected(unique_id, reason):
                    self._say(Rejected(attempt=0, unique_id=unique_id, reason=reason))
                case Remark(text):
                    _log.warning("%s: %s", self._name, text)
                case _:
                    assert_never(action)
        self._answer_questions()

    def _say(self, message: Incoming) -> None:
        self._said.put_nowait(message)

    def _report_loaded(self, report: ReportLoaded) -> None:
        self._say(
            self._reports.event(
                ComponentEventKind.LOADED,
                self._requests[report.attempt].load,
                unique_id=report.unique_id,
                full_name=report.full_name,
                message=report.remark,
                confirmed_by=report.confirmed_by,
            )
        )

    def _report_unloaded(self, attempt: int, unique_id: int, full_name: str, reason: str) -> None:
        self._say(
            self._reports.event(
                ComponentEventKind.UNLOADED,
                self._requests.pop(attempt).load,
                unique_id=unique_id,
                full_name=full_name,
                message=reason,
            )
        )

    def _answer_questions(self) -> None:
        """Answer, unless the container itself is being asked."""
        if not self._questions or self._composition.is_asking:
            return
        known = [
            (record, request)
            for attempt, request in self._requests.items()
            if (record := self._composition.find(attempt)) is not None
        ]
        nodes = tuple(self._reports.status(record, request) for record, request in known)
        for question in self._questions:
            self._say(Status(query_id=question.query_id, nodes=nodes))
        self._questions.clear()
        for attempt in self._requests.keys() - {record.attempt for record, _ in known}:
            del self._requests[attempt]

    async def _load(self, attempt: int) -> None:
        request = self._requests[attempt]
        await self._services.ready()
        async with self._places:
            if self._composition.stage(attempt) is not Stage.NEXT:
                return  # it was stopped while it waited for its turn
            reply = self._services.load_node(request.message)
            request.served_since = self._loop.time()
            request.cpu_time_ns = self._reports.container.cpu_time_ns()
            self._composition.sent(attempt)
            self._say(self._reports.event(ComponentEventKind.LOADING, request.load))
            reply.add_done_callback(lambda _: self._loaded(attempt, reply))
            # A constructor that takes longer than that keeps nobody else waiting.
            await asyncio.wait({reply}, timeout=self._timeout)

    def _loaded(self, attempt: int, reply: asyncio.Future[LoadReply]) -> None:
        if reply.cancelled() or self._is_closed:
            return
        self._silence.heard()
        answer = reply.result()
        self._do(
            self._composition.answered(
                attempt,
                success=answer.success,
                unique_id=answer.unique_id,
                full_name=answer.full_node_name,
                reason=answer.error_message,
            )
        )

    async def _unload(self, unique_id: int) -> None:
        await self._services.ready()
        reply = self._services.unload_node(unique_id)
        await asyncio.wait({reply}, timeout=self._limits.unload_node)
        success, reason = False, f"no answer within {self._limits.unload_node:g} s"
        if reply.done():
            self._silence.heard()
            success, reason = reply.result().success, reply.result().error_message
        if not success:
            _log.warning("%s: node %d is not unloaded: %s", self._name, unique_id, reason)
        self._do(self._composition.unload_answered(unique_id, success=success, reason=reason))

    async def _list(self, serial: int, delay: float) -> None:
        await asyncio.sleep(delay)
        reply = self._services.list_nodes()
        await asyncio.wait({reply}, timeout=self._limits.list_nodes)
        if reply.done():
            self._listed(serial, reply)
            return
        # It may come when the container has nothing else to do any more.
        reply.add_done_callback(lambda _: self._listed(serial, reply))
        if self._late_list is not None:
            self._late_list.cancel()
        self._late_list = reply
        if self._composition.current is None:
            self._silence.report()
        self._do(self._composition.list_unanswered(serial))

    def _listed(self, serial: int, reply: asyncio.Future[tuple[ListedNode, ...]]) -> None:
        if reply.cancelled() or self._is_closed:
            return
        self._silence.heard()
        nodes = reply.result()
        for attempt, request in self._requests.items():
            if self._composition.stage(attempt) is Stage.SENT and self._is_overdue(request):
                request.container_answers = True
        self.on_list(nodes)
        self._do(self._composition.listed(serial, nodes))

    async def _look_now_and_then(self) -> None:
        greeted = self._loop.time()
        while True:
            await asyncio.sleep(self._limits.look)
            if self._composition.current is None:
                self.look()
            if greeted and self._loop.time() - greeted > self._limits.lease:
                servers = await self._services.servers()
                if len(servers) > 1:
                    greeted = 0.0  # reported once
                    _log.warning(
                        "%d containers are called %s: each of them gets every request",
                        len(servers),
                        self._name,
                    )

    def _start(self, work: Coroutine[Any, Any, None]) -> None:
        task = self._loop.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._finished)

    def _finished(self, task: asyncio.Task[None]) -> None:
        self._tasks.discard(task)
        if not task.cancelled() and (error := task.exception()) is not None:
            _log.error("%s: %s", self._name, error, exc_info=error)
            self._said.put_nowait(ControlError(f"the dialogue has failed: {error}"))


def _wanted(load: Load) -> Wanted:
    """What the node will be called, as far as that is declared."""
    namespace = load.node_namespace
    label = f"{load.package_name}/{load.plugin_name}"
    if not load.node_name:
        return Wanted(namespace=namespace, label=label)
    return Wanted(f"{namespace.rstrip('/')}/{load.node_name}", namespace, label)
