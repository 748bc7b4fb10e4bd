"""Says to the service manager how the system is, for as long as it runs."""

from __future__ import annotations

import asyncio
import logging
import time
from typing import TYPE_CHECKING, Final

import anyio

from play_launch.deploy.phase import ANNOUNCED, EXTENDED, Phase, following, status
from play_launch.supervisor.events import ActionEvent, ManagedNodeChanged, StateEvent

if TYPE_CHECKING:
    from play_launch.deploy.notification import ServiceManager
    from play_launch.runtime.publisher import Publisher, StopRequests
    from play_launch.runtime.system import System
    from play_launch.supervisor.events import RunEvent
    from play_launch.supervisor.view import SystemView

_log = logging.getLogger(__name__)

_PULSE: Final = 10.0
"""Seconds between two messages where there is no watchdog, or a patient one."""
_PULSES: Final = 3
"""In the time that the watchdog allows: one may come late."""
_AT_ONCE: Final = 0.1
"""Seconds from a change to its message, so that many changes make few messages."""
_EXTENSION: Final = 3 * _PULSE
"""Seconds by which the time for the start is extended with each pulse."""


class ServiceReport:
    """What the service manager has heard. It belongs to the thread of the event loop.

    The watchdog is fed by a task of the event loop, so only as long as that turns, and only if the
    system says that all of its members are looked after.
    """

    def __init__(
        self,
        manager: ServiceManager,
        publisher: Publisher,
        stop: StopRequests,
        system: asyncio.Future[System],
        operable: asyncio.Future[None],
    ) -> None:
        """Report to the manager.

        Args:
            manager: Who hears it.
            publisher: Gives the events and the view.
            stop: Says when the end is asked for, and why.
            system: The one that runs, as soon as there is one.
            operable: Done when the commands reach the session, or never will: who is ready can be
                reloaded, and a manager may do so at once.
        """
        self._manager = manager
        self._publisher = publisher
        self._stop = stop
        self._begun = system
        self._operable = operable
        self._phase = Phase.STARTING
        self._status = ""
        self._health_problem = ""
        self._changed = asyncio.Event()
        publisher.add_sink(self)
        limit = manager.watchdog
        self.period = _PULSE if limit is None else min(_PULSE, limit / _PULSES)
        """Seconds between two pulses."""

    def publish(self, event: RunEvent, before: SystemView, after: SystemView) -> None:  # noqa: ARG002 - a sink
        """See an event."""
        if isinstance(event, StateEvent | ManagedNodeChanged | ActionEvent):
            self._changed.set()

    @property
    def _system(self) -> System | None:
        has_begun = self._begun.done() and not self._begun.cancelled()
        return self._begun.result() if has_begun else None

    async def run(self) -> None:
        """Report until this is cancelled, and then once more.

        An error of our own ends it: the watchdog then ends the supervisor, if it has one.
        """
        requested = asyncio.ensure_future(self._stop.requested.wait())
        for each in (requested, self._begun, self._operable):
            each.add_done_callback(lambda _: self._changed.set())
        try:
            while True:
                self._say()
                self._changed.clear()
                with anyio.move_on_after(self.period):
                    await self._changed.wait()
                await asyncio.sleep(min(_AT_ONCE, self.period))
        except Exception:
            _log.exception("the service manager hears nothing any more")
            raise
        finally:
            requested.cancel()
            self._say()

    def _say(self) -> None:
        """Send what is new, and that we are well; what is not taken is sent again."""
        system = self._system
        pending = () if system is None else system.pending
        ends = self._stop.requested.is_set()
        while True:
            phase = following(
                self._phase,
                is_up=system is not None and not pending and (self._operable.done() or ends),
                changes=system is not None and system.is_changing,
                ends=ends,
            )
            if phase is self._phase or not self._manager.notify(*_announcement(phase)):
                break
            self._phase = phase
        self._examine()
        said = status(
            self._phase,
            self._publisher.view,
            pending,
            reason=self._stop.reason,
            health_problem=self._health_problem,
        )
        pulse = [] if self._health_problem else self._pulse()
        if said != self._status:
            pulse.append(f"STATUS={said}")
        if pulse and self._manager.notify(*pulse):
            self._status = said

    def _pulse(self) -> list[str]:
        pulse = []
        if self._manager.watchdog is not None:
            pulse.append("WATCHDOG=1")
        if self._phase in EXTENDED:
            pulse.append(f"EXTEND_TIMEOUT_USEC={_EXTENSION * 1e6:.0f}")
        return pulse

    def _examine(self) -> None:
        system = self._system
        health_problem = "" if system is None else system.health_problem()
        if health_problem and health_problem != self._health_problem:
            _log.error("the watchdog of the service manager is not fed: %s", health_problem)
        self._health_problem = health_problem


def _announcement(phase: Phase) -> list[str]:
    lines = [ANNOUNCED[phase]]
    if phase is Phase.RELOADING:
        # As Type=notify-reload wants it; others take no notice.
        lines.append(f"MONOTONIC_USEC={time.clock_gettime_ns(time.CLOCK_MONOTONIC) // 1000}")
    return lines
