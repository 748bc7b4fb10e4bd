"""State and health of the system, reported to the service manager."""

from __future__ import annotations

import asyncio
import logging
import time
from typing import TYPE_CHECKING, Final

import anyio

from play_launch.supervisor.events import (
    ActionEvent,
    ContainerState,
    ManagedNodeChanged,
    StateEvent,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

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


class ServiceReport:
    """Reports by a task of the event loop, to the watchdog only without a health problem."""

    def __init__(
        self,
        manager: ServiceManager,
        publisher: Publisher,
        stop: StopRequests,
        system: asyncio.Future[System],
        operable: asyncio.Future[None],
    ) -> None:
        """Report to the manager.

        `operable` is done when commands reach the session, or never will: a manager may request a
        reload as soon as the service is ready.
        """
        self._manager = manager
        self._publisher = publisher
        self._stop = stop
        self._begun = system
        self._operable = operable
        self._state = "starting"
        """starting, ready, reloading or stopping."""
        self._status = ""
        self._health_problem = ""
        self._changed = asyncio.Event()
        publisher.add_sink(self)
        limit = manager.watchdog
        self._interval = _INTERVAL if limit is None else min(_INTERVAL, limit / 3)

    def publish(self, event: RunEvent, before: SystemView, after: SystemView) -> None:  # noqa: ARG002 - a sink
        if isinstance(event, StateEvent | ManagedNodeChanged | ActionEvent):
            self._changed.set()

    async def run(self) -> None:
        """Report until this is cancelled, and then once more."""
        requested = asyncio.ensure_future(self._stop.requested.wait())
        for each in (requested, self._begun, self._operable):
            each.add_done_callback(lambda _: self._changed.set())
        try:
            while True:
                self._report()
                self._changed.clear()
                with anyio.move_on_after(self._interval):
                    await self._changed.wait()
                await asyncio.sleep(min(_DELAY, self._interval))
        except Exception:
            _log.exception("reports to the service manager end")
            raise
        finally:
            requested.cancel()
            self._report()

    def _report(self) -> None:
        """Send what is new; a message that is not accepted is sent again."""
        has_begun = self._begun.done() and not self._begun.cancelled()
        system = self._begun.result() if has_begun else None
        pending = () if system is None else system.pending
        ends = self._stop.requested.is_set()
        is_up = system is not None and not pending and (self._operable.done() or ends)
        is_changing = system is not None and system.is_changing
        if self._state == "starting" and is_up:  # also if it stops at once
            self._enter("ready", "READY=1")
        if self._state != "stopping" and ends:
            self._enter("stopping", "STOPPING=1")
        elif self._state == "ready" and is_changing:
            now = time.clock_gettime_ns(time.CLOCK_MONOTONIC) // 1000
            self._enter("reloading", "RELOADING=1", f"MONOTONIC_USEC={now}")
        elif self._state == "reloading" and not is_changing:
            self._enter("ready", "READY=1")
        problem = "" if system is None else system.health_problem()
        if problem and problem != self._health_problem:
            _log.error("the watchdog of the service manager is not notified: %s", problem)
        self._health_problem = problem
        self._send(pending)

    def _enter(self, state: str, *message: str) -> None:
        if self._manager.notify(*message):
            self._state = state

    def _send(self, pending: Sequence[str]) -> None:
        words = [] if self._state == "ready" else [self._state]
        if self._state == "starting" and pending:
            words = [f"starting, pending: {_named(pending)}"]
        elif self._state == "stopping" and self._stop.reason:
            words = [f"stopping: {self._stop.reason}"]
        status = status_text(words, self._publisher.view, self._health_problem)
        lines = []
        if not self._health_problem:
            lines += ["WATCHDOG=1"] if self._manager.watchdog is not None else []
            lines += [_EXTENSION] if self._state in {"starting", "reloading"} else []
        if status != self._status:
            lines.append(f"STATUS={status}")
        if lines and self._manager.notify(*lines):
            self._status = status


def status_text(words: Sequence[str], view: SystemView, health_problem: str = "") -> str:
    """Return the line of `systemctl status`; it begins with `words`."""
    parts = [f"health problem: {health_problem}"] if health_problem else []
    parts += words
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
        parts.append(f"failed: {_named(failed)}")
    text = "; ".join(parts)
    return "".join(each if each.isprintable() else " " for each in text)[:_STATUS_LIMIT]


def _named(names: Sequence[str]) -> str:
    named = ", ".join(names[:_NAMES])
    return f"{named} and {len(names) - _NAMES} more" if len(names) > _NAMES else named
