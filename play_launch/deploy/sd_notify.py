"""State and health of the system, reported to the service manager."""

from __future__ import annotations

import asyncio
import logging
import time
from typing import TYPE_CHECKING, Final, NamedTuple

import anyio
from msgspec import Struct, field

from play_launch.config.text import listed
from play_launch.supervisor.events import (
    ActionEvent,
    ContainerState,
    ManagedNodeChanged,
    StateEvent,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from play_launch.deploy.notification import ServiceManager
    from play_launch.runtime.publisher import Publisher
    from play_launch.runtime.signals import StopRequests
    from play_launch.runtime.system import System
    from play_launch.supervisor.events import RunEvent
    from play_launch.supervisor.view import SystemView
_log = logging.getLogger(__name__)

_INTERVAL: Final = 10.0  # the watchdog may require less
_DELAY: Final = 0.1  # so that many changes make few messages
_EXTENSION: Final = f"EXTEND_TIMEOUT_USEC={3 * _INTERVAL * 1e6:.0f}"
_NAMES: Final = 3
_STATUS_LIMIT: Final = 400
"""Characters."""


class Seen(NamedTuple):
    """What is reported of a system."""

    is_up: bool = False
    """Whether all of it was there once, or has failed for good, and commands reach it."""
    pending: Sequence[str] = ()
    """What has to be there first."""
    is_changing: bool = False
    """Whether another configuration is being applied."""
    health_problem: str = ""
    summary: str = ""
    """What runs, and what has failed."""


def seen_of(
    publisher: Publisher,
    stop: StopRequests,
    begun: asyncio.Future[System],
    operable: asyncio.Future[None],
) -> Seen:
    """Look at the system of this process.

    ``operable`` is done when commands reach the session, or never will: a manager may request a
    reload as soon as the service is ready.
    """
    summary = summary_of(publisher.view)
    if not begun.done() or begun.cancelled():
        return Seen(summary=summary)
    system = begun.result()
    is_up = not system.pending and (operable.done() or stop.requested.is_set())
    problem = system.health_problem()
    return Seen(is_up, system.pending, system.is_changing, problem, summary)


class ServiceReport(Struct, eq=False):
    """Reports by a task of the event loop, to the watchdog only without a health problem."""

    manager: ServiceManager
    stop: StopRequests
    look: Callable[[], Seen]
    state: str = "starting"
    """starting, ready, reloading or stopping."""
    status: str = ""
    health_problem: str = ""
    changed: asyncio.Event = field(default_factory=asyncio.Event)

    @property
    def _interval(self) -> float:
        limit = self.manager.watchdog
        return _INTERVAL if limit is None else min(_INTERVAL, limit / 3)

    def publish(self, event: RunEvent, before: SystemView, after: SystemView) -> None:  # noqa: ARG002 - a sink
        if isinstance(event, StateEvent | ManagedNodeChanged | ActionEvent):
            self.changed.set()

    async def run(self) -> None:
        """Report until this is cancelled, and then once more."""
        requested = asyncio.ensure_future(self.stop.requested.wait())
        requested.add_done_callback(lambda _: self.changed.set())
        try:
            while True:
                self._report()
                self.changed.clear()
                with anyio.move_on_after(self._interval):
                    await self.changed.wait()
                await asyncio.sleep(min(_DELAY, self._interval))
        except Exception:
            _log.exception("reports to the service manager end")
            raise
        finally:
            requested.cancel()
            self._report()

    def _report(self) -> None:
        """Send what is new; a message that is not accepted is sent again."""
        seen = self.look()
        ends = self.stop.requested.is_set()
        if self.state == "starting" and seen.is_up:  # also if it stops at once
            self._enter("ready", "READY=1")
        if self.state != "stopping" and ends:
            self._enter("stopping", "STOPPING=1")
        elif self.state == "ready" and seen.is_changing:
            now = time.clock_gettime_ns(time.CLOCK_MONOTONIC) // 1000
            self._enter("reloading", "RELOADING=1", f"MONOTONIC_USEC={now}")
        elif self.state == "reloading" and not seen.is_changing:
            self._enter("ready", "READY=1")
        if seen.health_problem not in {"", self.health_problem}:
            text = "the watchdog of the service manager is not notified: %s"
            _log.error(text, seen.health_problem)
        self.health_problem = seen.health_problem
        self._send(seen)

    def _enter(self, state: str, *message: str) -> None:
        if self.manager.notify(*message):
            self.state = state

    def _send(self, seen: Seen) -> None:
        words = [] if self.state == "ready" else [self.state]
        if self.state == "starting" and seen.pending:
            words = [f"starting, pending: {listed(seen.pending, _NAMES)}"]
        elif self.state == "stopping" and self.stop.reason:
            words = [f"stopping: {self.stop.reason}"]
        status = status_text(words, seen.summary, self.health_problem)
        lines = []
        if not self.health_problem:
            lines += ["WATCHDOG=1"] if self.manager.watchdog is not None else []
            lines += [_EXTENSION] if self.state in {"starting", "reloading"} else []
        if status != self.status:
            lines.append(f"STATUS={status}")
        if lines and self.manager.notify(*lines):
            self.status = status


def status_text(words: Sequence[str], summary: str, health_problem: str = "") -> str:
    """Return the line of `systemctl status`; it begins with `words`."""
    problem = f"health problem: {health_problem}" if health_problem else ""
    text = "; ".join(filter(None, (problem, *words, summary)))
    return "".join(each if each.isprintable() else " " for each in text)[:_STATUS_LIMIT]


def summary_of(view: SystemView) -> str:
    parts = []
    counts = [f"{view.loaded} of {view.total} nodes loaded"] if view.total else []
    if view.containers:
        running = sum(e.state is ContainerState.RUNNING for e in view.containers.values())
        counts.append(f"{running} of {len(view.containers)} containers running")
    if view.processes:
        running = sum(each.pid != 0 for each in view.processes.values())
        counts.append(f"{running} of {len(view.processes)} processes running")
    if counts:
        parts.append(", ".join(counts))
    expected = view.expected
    failed = [
        *expected.gave_up,
        *(each.node for each in expected.failed if each.container not in expected.gave_up),
        *(each.name for each in expected.failed_processes),
        *(each.unit.rpartition(":")[2] for each in view.failed_managed),
    ]
    if failed:
        parts.append(f"failed: {listed(failed, _NAMES)}")
    return "; ".join(parts)
