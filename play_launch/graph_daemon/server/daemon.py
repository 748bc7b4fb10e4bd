"""The daemon: node, server and watchers together, from its start to its end."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import os
import signal
import time
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Final

from play_launch.graph_daemon.contract import IDLE_TIMEOUT, LISTENING, WARM
from play_launch.graph_daemon.server.clients import Limits, Server
from play_launch.graph_daemon.server.interfaces import InterfaceWatch
from play_launch.graph_daemon.server.replacement import Replacer
from play_launch.graph_daemon.server.service import GraphService
from play_launch.graph_daemon.server.warm_up import participants_here
from play_launch.ros.fastdds.own_participant import OwnParticipant, decide
from play_launch.ros.fastdds.profiles import files_here

if TYPE_CHECKING:
    import socket
    from collections.abc import Callable, Iterator

    from play_launch.graph_daemon.contract import DaemonAddress

_SIGNALS: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_MOST_IDLE_CHECK: Final = 60.0
STATUS_VERSION: Final = 1
"""Of the format of `DaemonStatus`; a field may be added without a change of it."""
_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class DaemonStatus:
    """The daemon's state at one moment: the answer of ``system.play_launch_status``."""

    daemon: str = "play_launch"
    version: int = STATUS_VERSION
    pid: int
    domain: int
    rmw: str
    """The middleware's identifier, such as ``rmw_fastrtps_cpp``."""
    node: str
    """Name of the node that looks at the graph."""
    age: float
    """Seconds since the daemon started."""
    warm: bool
    """Whether it answers about the graph; before, such requests wait."""
    settled: bool
    """Whether nothing changed for half a second and no participant is known to be missing."""
    generation: int
    """Grows with every change of the graph."""
    unchanged_for: float
    """Seconds since the last change."""
    changes_per_second: float
    """Over the last ten seconds. Changes within 50 ms count as one."""
    nodes: int
    """Nodes in the graph, without the daemon's own."""
    participants: int
    """DDS participants that the daemon has met, itself too; 0 where that cannot be seen."""
    participants_here: int
    """DDS participants of the domain on this machine, by the kernel's table of sockets."""
    replacements: int
    """How often the node was replaced because the network's addresses changed."""
    requests: int
    cached_replies: int
    """Requests that were answered without asking the graph again."""
    connections: int
    resets: int
    """Connections that were reset for their deadline, or because there were too many."""
    idle_timeout: float
    """Seconds without a request after which the daemon ends; 0 for never."""
    transports: str
    """As a value of FASTDDS_BUILTIN_TRANSPORTS, empty when they are not the daemon's choice."""
    transports_reason: str
    """Why; empty with another middleware than Fast DDS, where the variable means nothing."""

    def to_json(self) -> str:
        """Return it as one JSON object."""
        return json.dumps(asdict(self), ensure_ascii=False)


class Daemon:
    """One daemon of one domain.

    Args:
        address: Where it serves, for its domain.
        idle_timeout: Seconds without a request after which it ends; 0 for never.
        limits: What clients may take.
    """

    def __init__(
        self,
        address: DaemonAddress,
        *,
        idle_timeout: float = IDLE_TIMEOUT,
        limits: Limits | None = None,
    ) -> None:
        self._address = address
        self._idle_timeout = idle_timeout
        self._limits = limits
        self._started = time.monotonic()

    async def run(self, listener: socket.socket, report: Callable[[str], None]) -> None:
        """Serve until a client, a signal or idleness ends it.

        Args:
            listener: Listens at the address; it belongs to the daemon from now on.
            report: Called with `LISTENING` and `WARM` when it has come so far.
        """
        # Loads ROS, which takes a while; meanwhile clients queue at the listener.
        from play_launch.graph_daemon.server.ros_graph import (  # noqa: PLC0415
            RosGraph,
            graph_functions,
            rmw_implementation,
        )

        self._rmw = rmw_implementation()
        self._participant = decide(os.environ, files_here(), self._rmw) or OwnParticipant("", "")
        self._end = asyncio.Event()
        self._service = GraphService(
            graph_functions(lambda: self._service.graph),
            participants_here=lambda: participants_here(self._address.domain),
            status=self._status_text,
            shutdown=self._shut_down,
        )
        self._server = Server(listener, self._service.answer, self._limits)

        def build() -> RosGraph:
            return RosGraph(self._address.domain, self._service.changed)

        self._replacer = Replacer(self._service, build)
        self._service.use(await asyncio.to_thread(build))
        self._server.start()
        with self._ended_by_signals(), self._watching_interfaces():
            report(LISTENING)
            tasks = [
                asyncio.create_task(self._replacer.run()),
                asyncio.create_task(self._end_when_idle()),
                asyncio.create_task(self._report_warm(report)),
            ]
            try:
                await self._end.wait()
            finally:
                await self._close(tasks)

    def status(self) -> DaemonStatus:
        """Return how it is."""
        now = time.monotonic()
        service, server = self._service, self._server
        known = service.population()
        pulse = service.pulse
        return DaemonStatus(
            pid=os.getpid(),
            domain=self._address.domain,
            rmw=self._rmw,
            node=service.graph.name,
            age=now - self._started,
            warm=service.is_warm,
            settled=pulse.is_quiet(now) and known.is_complete,
            generation=service.generation,
            unchanged_for=pulse.quiet_for(now),
            changes_per_second=pulse.rate(now),
            nodes=known.nodes,
            participants=known.participants,
            participants_here=known.participants_here,
            replacements=self._replacer.replacements,
            requests=server.requests,
            cached_replies=service.cached_replies,
            connections=server.connections,
            resets=server.resets,
            idle_timeout=self._idle_timeout,
            transports=self._participant.transports,
            transports_reason=self._participant.reason,
        )

    def _status_text(self, generation: str = "") -> str:
        # To count participants takes longer than all the rest of an answer.
        is_known = generation == str(self._service.generation)
        return "" if is_known else self.status().to_json()

    def _shut_down(self) -> None:
        # At once: when its caller has the answer, the port refuses connections.
        self._server.stop_listening()
        self._end.set()

    async def _close(self, tasks: list[asyncio.Task[None]]) -> None:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        self._service.close()
        await self._server.close()
        await asyncio.to_thread(self._service.graph.close)

    async def _report_warm(self, report: Callable[[str], None]) -> None:
        await self._service.wait_warm()
        report(WARM)

    async def _end_when_idle(self) -> None:
        if not self._idle_timeout:
            return
        while True:
            left = self._service.last_request + self._idle_timeout - time.monotonic()
            if left <= 0:
                _log.info("no request for %g s", self._idle_timeout)
                self._end.set()
                return
            await asyncio.sleep(min(left, _MOST_IDLE_CHECK))

    @contextlib.contextmanager
    def _ended_by_signals(self) -> Iterator[None]:
        loop = asyncio.get_running_loop()
        for number in _SIGNALS:
            loop.add_signal_handler(number, self._end.set)
        try:
            yield
        finally:
            for number in _SIGNALS:
                loop.remove_signal_handler(number)

    @contextlib.contextmanager
    def _watching_interfaces(self) -> Iterator[None]:
        try:
            watch = InterfaceWatch(self._replacer.request)
        except OSError as error:
            _log.warning("changes of the machine's addresses go unnoticed: %s", error)
            yield
            return
        try:
            yield
        finally:
            watch.close()
