"""The one way to the outside: each event is folded into the view once, and handed out with it."""

from __future__ import annotations

import asyncio
import logging
import time
from typing import TYPE_CHECKING

from play_launch.process.resources import held_resources, shortfalls
from play_launch.supervisor.events import ContainerStateChanged, OutputLine, Withdrawn
from play_launch.supervisor.view import SystemView

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from play_launch.config.resources import Resources
    from play_launch.process.lines import Line
    from play_launch.supervisor.events import ContainerState, RunEvent, Stream, SubjectKind
    from play_launch.supervisor.view import StateSink

_log = logging.getLogger(__name__)


class Publisher:
    """Hands every event to the sinks, with the view before and after it."""

    def __init__(self, *sinks: StateSink, stamp_ns: Callable[[], int] = time.time_ns) -> None:
        """Take the sinks; ``stamp_ns`` gives the wall-clock time in nanoseconds."""
        self._sinks = list(sinks)
        self.stamp_ns = stamp_ns
        self.view = SystemView()
        self._stop: StopRequests | None = None
        self._view_before_stop: SystemView | None = None
        self._warnings: set[str] = set()

    def add_sink(self, sink: StateSink) -> None:
        """Hand the events from now on to another sink as well."""
        self._sinks.append(sink)

    def is_news(self, warning: str) -> bool:
        """Whether a warning that may concern many members alike is given for the first time."""
        if warning in self._warnings:
            return False
        self._warnings.add(warning)
        return True

    @property
    def view_before_stop(self) -> SystemView:
        """The view as it was when the first stop was requested, or is as long as none was."""
        return self._view_before_stop or self.view

    def remember_view_before(self, stop: StopRequests) -> None:
        """Keep the view that holds when a stop is requested: the first event after that is late."""
        self._stop = stop

    def publish(self, event: RunEvent) -> None:
        """Take one event."""
        if self._view_before_stop is None and self._stop and self._stop.requested.is_set():
            self._view_before_stop = self.view
        before = self.view
        self.view = after = before.after(event)
        for sink in tuple(self._sinks):
            try:
                sink.publish(event, before, after)
            except Exception:  # noqa: BLE001 - must not stop the member whose event it is
                self._sinks.remove(sink)
                _log.exception("%s failed and gets no more events", type(sink).__name__)

    def publish_container(
        self, name: str, state: ContainerState, reason: str, mechanism: str
    ) -> None:
        """Publish the state of a container; ``mechanism`` is empty unless it runs."""
        self.publish(
            ContainerStateChanged(
                stamp_ns=self.stamp_ns(),
                container=name,
                state=state,
                reason=reason,
                mechanism=mechanism,
            )
        )

    def withdraw(self, kind: SubjectKind, key: str) -> None:
        """Publish that something was taken out of the running system."""
        self.publish(Withdrawn(stamp_ns=self.stamp_ns(), kind=kind, key=key))

    def publish_output(self, name: str, pid: int, stream: Stream, lines: Sequence[Line]) -> None:
        """Take what a process wrote."""
        stamp_ns = self.stamp_ns()
        for line in lines:
            self.publish(
                OutputLine(
                    stamp_ns=stamp_ns,
                    process=name,
                    pid=pid,
                    stream=stream,
                    text=line.text,
                    truncated=line.truncated,
                )
            )


class StopRequests:
    """The first request stops the system in order; the second signal hurries that.

    Several crashes of one moment may each ask for the end, and so may a crash and a signal: that
    is nobody's impatience.

    Belongs to the thread of the event loop: hand signals over with ``loop.call_soon_threadsafe``.
    """

    def __init__(self) -> None:
        self.requested = asyncio.Event()
        self.hurry = asyncio.Event()
        self.signum: int | None = None
        """The signal of the first request; None where it was none."""
        self.reason = ""
        self._signals = 0

    def request(self, signum: int | None = None, reason: str = "") -> None:
        """Ask for the end, or with a second signal for more haste."""
        self._signals += signum is not None
        if self.requested.is_set():
            if self._signals > 1:
                self.hurry.set()
            return
        self.signum = signum
        self.reason = reason or (f"signal {signum}" if signum is not None else "requested")
        self.requested.set()


def report_shortfalls(name: str, wanted: Resources, pid: int, publisher: Publisher) -> None:
    """Report once each resource that the kernel refused; the process runs without it."""
    if not wanted or not pid:
        return
    held = held_resources(pid, wanted.limit_names)
    if held is None:  # it has ended, which is reported anyway
        return
    for shortfall in shortfalls(wanted, held):
        text = f"{name}: {shortfall}"
        if publisher.is_news(text):
            _log.warning("%s", text)
