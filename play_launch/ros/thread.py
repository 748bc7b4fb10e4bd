"""ROS nodes of this process: one for each domain, each in a thread of its own, shared by its users.

rclpy's nodes and clients may be used by one thread at a time, and its waits block. So all of them
live in that thread; the event loop posts work and gets results, and neither waits for the other.
"""

from __future__ import annotations

import asyncio
import logging
import os
import threading
from collections import deque
from contextlib import asynccontextmanager, suppress
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeVar

import anyio

from play_launch.ros.fastdds.own_participant import as_our_own, made_safely

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable, Mapping

    from rclpy.context import Context
    from rclpy.node import Node

    from play_launch.ros.waiting import Waiter

_log = logging.getLogger(__name__)
_T = TypeVar("_T")

_JOIN_LIMIT: Final = 5.0
"""Seconds for the thread's end."""
_DOMAIN: Final = "ROS_DOMAIN_ID"
_MOST_FAILURES: Final = 1000
"""After that many the thread ends, with a log message."""


class RosThreadError(Exception):
    """The thread has not started, or has ended."""


class _Work(NamedTuple):
    do: Callable[[Node], None]
    refuse: Callable[[RosThreadError], None] | None
    when: Callable[[Node], bool] | None


class RosThread:
    """An rclpy node in a thread of its own.

    ``start``, ``until_started`` and ``close`` wait for the thread, 0.1 s and more for a DDS
    participant: call them from another thread than the event loop's. The rest never blocks.
    """

    def __init__(self, name: str, *, domain_id: int | None = None) -> None:
        """Name the node; without a ``domain_id`` that of the environment is used."""
        self.name = name
        self._domain_id = domain_id
        self._work: deque[_Work] = deque()
        self._awaiting: list[_Work] = []
        """What is to be done when the graph has changed."""
        self._started = threading.Event()
        self._failure: BaseException | None = None
        self._ended: RosThreadError | None = None
        self._closing = False
        self._failures = 0
        self._wake: Callable[[], None] = lambda: None
        self._thread = threading.Thread(target=self._run, name=f"ros {name}", daemon=True)
        self.domain_id = 0
        """The domain that the node is in, once started."""
        self.rmw_implementation = ""
        self.graph_changes = 0
        """How often the graph was seen to change; several changes may count as one."""

    @property
    def has_ended(self) -> bool:
        """Whether it refuses all work: it failed, or was closed."""
        return self._ended is not None

    def begin(self) -> None:
        """Start without waiting; work that is posted meanwhile is done once the node exists."""
        self._thread.start()

    def until_started(self) -> None:
        """Wait until the node exists; raises what prevented that."""
        self._started.wait()
        if self._failure is not None:
            raise self._failure

    def start(self) -> None:
        """Start and wait until the node exists."""
        self.begin()
        self.until_started()

    def close(self) -> None:
        """End it and wait for its end; harmless when it has not started, or has ended."""
        self._closing = True
        self._wake()
        if not self._thread.is_alive():
            return
        self._thread.join(_JOIN_LIMIT)
        if self._thread.is_alive():
            _log.error("the ROS thread does not end")

    def post(
        self,
        work: Callable[[Node], None],
        refuse: Callable[[RosThreadError], None] | None = None,
        *,
        when: Callable[[Node], bool] | None = None,
    ) -> None:
        """Have something done in the thread, in order; from any thread, at any time.

        ``refuse`` is called in its place when the thread cannot do it any more. With ``when`` it is
        done as soon as that holds, which is looked at now and after changes of the graph.
        """
        self._work.append(_Work(work, refuse, when))
        self._wake()
        if self._ended is not None:
            self._refuse_all(self._ended)

    async def call(self, work: Callable[[Node], _T]) -> _T:
        """Have something done in the thread and wait for its result.

        Raises RosThreadError when the thread did not start, or ends before that.
        """
        loop = asyncio.get_running_loop()
        future: asyncio.Future[_T] = loop.create_future()

        def run(node: Node) -> None:
            try:
                result = work(node)
            except Exception as error:  # noqa: BLE001 - it is the caller's
                hand_over(loop, _fail, future, error)
            else:
                hand_over(loop, _finish, future, result)

        self.post(run, lambda error: hand_over(loop, _fail, future, error))
        return await future

    async def until(self, holds: Callable[[Node], bool]) -> None:
        """Wait until something is so, looking in the thread now and after changes of the graph.

        Raises RosThreadError as `call`.
        """
        loop = asyncio.get_running_loop()
        future: asyncio.Future[None] = loop.create_future()

        def is_over(node: Node) -> bool:
            try:
                return future.done() or holds(node)
            except Exception as error:  # noqa: BLE001
                hand_over(loop, _fail, future, error)
                return True

        self.post(
            lambda _: hand_over(loop, _finish, future, None),
            lambda error: hand_over(loop, _fail, future, error),
            when=is_over,
        )
        try:
            await future
        except asyncio.CancelledError:
            self.check_again()  # else it stays until the graph changes
            raise

    async def request(self, client: Callable[[Node], Any], message: Callable[[Any], Any]) -> Any:
        """Send a request of a service's client and wait for the response.

        Both are called in the thread, the second one with the type of the service. Raises what
        ``call`` does, and what comes in place of a response.
        """
        loop = asyncio.get_running_loop()
        response: asyncio.Future[Any] = loop.create_future()

        def came(expected: Any) -> None:
            error = expected.exception()
            if error is None:
                hand_over(loop, _finish, response, expected.result())
            else:
                hand_over(loop, _fail, response, error)

        def send(node: Node) -> tuple[Any, Any]:
            sender = client(node)
            expected = sender.call_async(message(sender.srv_type))
            expected.add_done_callback(came)
            return sender, expected

        sender, expected = await self.call(send)
        try:
            return await response
        except asyncio.CancelledError:
            self.post(lambda _: sender.remove_pending_request(expected))
            raise

    def check_again(self) -> None:
        """Have conditions that `until` waits for checked without a change of the graph."""
        self.post(lambda _: self._look_again())

    def _run(self) -> None:
        try:
            context, node, waiting = self._open()
        except BaseException as error:  # noqa: BLE001 - raised again where it was started
            self._failure = error
            self._end(f"the supervisor's ROS node does not start: {error}")
            self._started.set()
            _log.error("the ROS thread does not start: %s", error)
            return
        try:
            self._started.set()
            while not self._closing:
                self._do_work(node)
                self._wait(waiting)
            self._end("the supervisor's ROS node is closed")
        except Exception as error:  # noqa: BLE001 - it is reported
            _log.exception("the ROS thread has failed")
            self._end(f"the supervisor's ROS node has failed: {error}")
        finally:
            self._wake = lambda: None
            waiting.close()
            node.destroy_node()  # type: ignore[no-untyped-call]
            context.try_shutdown()

    def _open(self) -> tuple[Context, Node, Waiter]:
        from play_launch.ros.waiting import Waiter  # noqa: PLC0415 - imports rclpy

        context, node, self.rmw_implementation = open_node(self.name, self._domain_id)
        waiting = Waiter(node, self._graph_changed)
        self._wake = waiting.wake
        self.domain_id = context.get_domain_id()
        return context, node, waiting

    def _wait(self, waiting: Waiter) -> None:
        try:
            waiting.wait()
        except Exception:
            # For example an answer that cannot be read. One bad client must not end them all.
            self._failures += 1
            if self._failures >= _MOST_FAILURES:
                raise
            _log.exception("something in the ROS thread failed")

    def _end(self, reason: str) -> None:
        """Refuse what waits, and whatever comes later."""
        self._ended = RosThreadError(reason)
        self._look_again()
        self._refuse_all(self._ended)

    def _refuse_all(self, error: RosThreadError) -> None:
        while True:
            try:
                work = self._work.popleft()
            except IndexError:  # also when another thread refuses at the same time
                return
            if work.refuse is not None:
                work.refuse(error)

    def _do_work(self, node: Node) -> None:
        while self._work:
            work = self._work.popleft()
            try:
                if work.when is None or work.when(node):
                    work.do(node)
                else:
                    self._awaiting.append(work)
            except Exception:  # noqa: BLE001 - the others' work goes on
                _log.exception("work in the ROS thread failed")

    def _graph_changed(self) -> None:
        self.graph_changes += 1
        self._look_again()

    def _look_again(self) -> None:
        self._work.extend(self._awaiting)
        self._awaiting.clear()


class NodePool:
    """Threads with hidden nodes, one for each domain, each as long as it has users."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._threads: dict[int, RosThread] = {}
        self._users: dict[RosThread, int] = {}

    def acquire(self, environment: Mapping[str, str]) -> RosThread:
        """Return the thread of the domain that these variables name, else this process's.

        It may not have started yet, and is to be released.
        """
        domain = int(environment.get(_DOMAIN) or os.environ.get(_DOMAIN) or 0)
        with self._lock:
            thread = self._threads.get(domain)
            if thread is None or thread.has_ended:
                # A name that `ros2 node list` does not show.
                thread = RosThread(f"_play_launch_{os.getpid()}", domain_id=domain)
                thread.begin()
                self._threads[domain] = thread
            self._users[thread] = self._users.get(thread, 0) + 1
        return thread

    def release(self, thread: RosThread) -> None:
        """End a use; the last one closes the thread, and waits for that."""
        with self._lock:
            self._users[thread] -= 1
            if self._users[thread]:
                return
            del self._users[thread]
            self._threads = {key: each for key, each in self._threads.items() if each is not thread}
        thread.close()

    @asynccontextmanager
    async def used(self, environment: Mapping[str, str]) -> AsyncIterator[RosThread]:
        """Acquire the thread for the time of the block."""
        thread = self.acquire(environment)
        try:
            yield thread
        finally:
            await self.leave(thread)

    async def leave(self, thread: RosThread) -> None:
        """End a use as `release` does, also when this is cancelled.

        Not even before an executor thread is free for it: a thread of ROS that lives when Python
        ends aborts the process.
        """
        released = asyncio.get_running_loop().run_in_executor(None, self.release, thread)
        with anyio.CancelScope(shield=True):
            await asyncio.shield(released)


node_pool: Final = NodePool()
"""The pool of this process."""


def open_node(name: str, domain_id: int | None = None) -> tuple[Context, Node, str]:
    """Make a node without services and log files, in a context, so a participant, of its own.

    Without a ``domain_id`` the environment's holds. The third value is the middleware in use.
    """
    # Takes long, and most sessions need none of it.
    from rclpy.context import Context  # noqa: PLC0415
    from rclpy.node import Node  # noqa: PLC0415
    from rclpy.parameter import Parameter  # noqa: PLC0415
    from rclpy.utilities import get_rmw_implementation_identifier  # noqa: PLC0415

    # Services are not waited for, and all others would have to discover this one.
    off = Parameter("start_type_description_service", value=False)  # type: ignore[no-untyped-call]
    context, rmw = Context(), get_rmw_implementation_identifier()
    with as_our_own(os.environ, rmw) as chosen:
        # A user may have no home for log files.
        context.init(args=["--ros-args", "--disable-external-lib-logs"], domain_id=domain_id)
        with made_safely(chosen):
            node = Node(
                name,
                context=context,
                use_global_arguments=False,
                enable_rosout=False,
                start_parameter_services=False,
                parameter_overrides=[off],
            )
    return context, node, rmw


def hand_over(loop: asyncio.AbstractEventLoop, callback: Callable[..., Any], *values: Any) -> None:
    """Call something in a loop, from any thread."""
    # A loop that has ended in the meantime has no waiters.
    with suppress(RuntimeError):
        loop.call_soon_threadsafe(callback, *values)


def _finish(future: asyncio.Future[_T], result: _T) -> None:
    if not future.done():
        future.set_result(result)


def _fail(future: asyncio.Future[Any], error: BaseException) -> None:
    if not future.done():
        future.set_exception(error)
