"""The daemon: node and server together, from its start to its end."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import os
import signal
import threading
import time
from typing import TYPE_CHECKING, Final

from play_launch.graph_daemon.contract import IDLE_TIMEOUT, LISTENING, WARM
from play_launch.graph_daemon.http_server import HttpServer
from play_launch.graph_daemon.service import GraphService
from play_launch.graph_daemon.warm_up import addresses, participants_here
from play_launch.ros.fastdds.middleware import files_here
from play_launch.ros.fastdds.own_participant import OwnParticipant, decide

if TYPE_CHECKING:
    import socket
    from collections.abc import Callable

    from play_launch.graph_daemon.contract import DaemonAddress
    from play_launch.graph_daemon.ros_graph import RosGraph

_SIGNALS: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_TICK: Final = 0.1
"""Seconds between two checks of the daemon itself, at the start."""
_QUIET_TICK: Final = 0.25
"""Seconds between them afterwards."""
_ADDRESS_INTERVAL: Final = 2.0
"""Seconds between two checks of the machine's addresses."""
LONGEST_DOUBT: Final = 25.0
"""Seconds; a participant that was killed is forgotten after 20."""
REPLACEMENT_TIME: Final = 3.0
"""Seconds that a new node has to discover the others before it is used, at least."""
_LONGEST_REPLACEMENT: Final = 10.0
"""Seconds after which it is used although it does not know all participants of this machine."""
STATUS_VERSION: Final = 1
"""Of the format of the status; a field may be added without a change of it."""
_log = logging.getLogger(__name__)


class Doubts:
    """The nodes of the graph that may not exist any more, and since when they are doubtful."""

    def __init__(self) -> None:
        self.generation = -1
        """Of the graph that was looked at."""
        self._since: dict[tuple[str, str], float] = {}
        self._settled: set[tuple[str, str]] = set()

    def look(self, now: float, doubtful: frozenset[tuple[str, str]]) -> None:
        self._since = {each: self._since.get(each, now) for each in doubtful}
        self._settled &= doubtful

    def take_old(self, now: float) -> list[str]:
        """Give the full names of those that are due to be looked at anew; each once."""
        old = {each for each, since in self._since.items() if now - since >= LONGEST_DOUBT}
        new = old - self._settled
        self._settled |= new
        return sorted(f"{namespace.rstrip('/')}/{name}" for name, namespace in new)


class Daemon:
    """The daemon of a domain; it ends after so many seconds without a request, 0 is never."""

    def __init__(self, address: DaemonAddress, *, idle_timeout: float = IDLE_TIMEOUT) -> None:
        self._address = address
        self._idle_timeout = idle_timeout
        self._started = time.monotonic()
        self._ended = threading.Event()
        self._replacing: threading.Thread | None = None
        self._replacements = 0
        self._doubts = Doubts()

    async def run(self, listener: socket.socket, report: Callable[[str], None]) -> None:
        """Serve until a client, a signal or idleness ends it; for the main thread.

        The listener belongs to the daemon; ``report`` is called with `LISTENING` and `WARM` when
        these states are reached.
        """
        # Loads ROS, which takes a while; meanwhile clients queue at the listener.
        from play_launch.graph_daemon.ros_graph import (  # noqa: PLC0415
            RosGraph,
            graph_functions,
            rmw_implementation,
        )

        self._rmw = rmw_implementation()
        self._participant = decide(os.environ, files_here(), self._rmw) or OwnParticipant("", "")
        self._service = GraphService(
            graph_functions(lambda: self._service.graph),
            participants_here=lambda: participants_here(self._address.domain),
            status=self._status_text,
            shutdown=self._shut_down,
        )

        def build() -> RosGraph:
            return RosGraph(self._address.domain, self._service.changed)

        self._build = build
        self._known, self._addresses_checked = addresses(), self._started
        self._service.use(self._build())
        self._server = HttpServer(listener, self._service.answer)
        self._is_over = asyncio.Event()
        for number in _SIGNALS:
            asyncio.get_running_loop().add_signal_handler(number, self._is_over.set)
        self._server.start()
        report(LISTENING)
        try:
            while not self._is_over.is_set():
                with contextlib.suppress(TimeoutError):
                    async with asyncio.timeout(_QUIET_TICK if self._service.is_warm else _TICK):
                        await self._is_over.wait()
                self._check(report)
        finally:
            self._ended.set()
            self._service.close()
            await self._server.close()
            if self._replacing is not None:
                self._replacing.join()
            self._service.graph.close()

    def _status_text(self, generation: str = "") -> str:
        """Return the state as one JSON object; docs/daemon.md describes the fields."""
        service, server = self._service, self._server
        # To count participants takes longer than all the rest of an answer.
        if generation == str(service.generation):
            return ""
        now = time.monotonic()
        known, pulse = service.population(), service.pulse
        values = {
            "daemon": "play_launch",
            "version": STATUS_VERSION,
            "pid": os.getpid(),
            "domain": self._address.domain,
            "rmw": self._rmw,
            "node": service.graph.name,
            "age": now - self._started,
            "warm": service.is_warm,
            "settled": pulse.is_quiet(now) and known.is_complete,
            "generation": service.generation,
            "unchanged_for": pulse.quiet_for(now),
            "changes_per_second": pulse.rate(now),
            "nodes": known.nodes,
            "participants": known.participants,
            "participants_here": known.participants_here,
            "replacements": self._replacements,
            "requests": server.requests,
            "cached_replies": service.cached_replies,
            "connections": server.connections,
            "resets": server.resets,
            "idle_timeout": self._idle_timeout,
            "transports": self._participant.transports,
            "transports_reason": self._participant.reason,
        }
        return json.dumps(values, ensure_ascii=False)

    def _shut_down(self) -> None:
        # At once: when its caller has the answer, the port refuses connections.
        self._is_over.set()
        self._server.stop_listening()

    def _check(self, report: Callable[[str], None]) -> None:
        now = time.monotonic()
        if not self._service.is_warm and self._service.check_warm():
            report(WARM)
        if self._idle_timeout and now - self._service.last_request > self._idle_timeout:
            _log.info("no request for %g s", self._idle_timeout)
            self._is_over.set()
        if now - self._addresses_checked < _ADDRESS_INTERVAL:
            return
        self._addresses_checked = now
        if self._replacing is None or not self._replacing.is_alive():
            current = addresses()
            if current != self._known:
                self._known = current
                self._begin_to_replace("the addresses of the machine have changed")
            elif old := self._old_doubts(now):
                self._begin_to_replace(f"{', '.join(old)} may not exist any more")

    def _old_doubts(self, now: float) -> list[str]:
        service, doubts = self._service, self._doubts
        if doubts.generation != service.generation and service.pulse.is_quiet(now):
            doubts.generation = service.generation
            with contextlib.suppress(Exception):  # whatever rclpy raises
                doubts.look(now, service.doubtful())
        return doubts.take_old(now)

    def _begin_to_replace(self, reason: str) -> None:
        _log.info("%s; creating a new node", reason)
        self._replacing = threading.Thread(target=self._replace, daemon=True)
        self._replacing.start()

    def _replace(self) -> None:
        """Use a new node: a participant keeps its addresses, and what it was once told."""
        old = self._service.graph
        try:
            new: RosGraph = self._build()
        except Exception:  # noqa: BLE001 - whatever rclpy raises
            _log.exception("no new node could be created; the old one stays in use")
            return
        latest = time.monotonic() + _LONGEST_REPLACEMENT
        self._ended.wait(REPLACEMENT_TIME)
        while not self._service.is_settled(new) and time.monotonic() < latest:
            if self._ended.wait(_TICK):
                break
        self._service.use(new)
        self._replacements += 1
        old.close()
