"""Publishes events: each is folded into the view once, and passed to the sinks with it."""

from __future__ import annotations

import asyncio
import logging
import time
from typing import TYPE_CHECKING

from play_launch.process.resources import held_resources, shortfalls
from play_launch.supervisor.events import OutputLine
from play_launch.supervisor.view import SystemView

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from play_launch.config.resources import Resources
    from play_launch.process.lines import Line
    from play_launch.supervisor.events import RunEvent, Stream
    from play_launch.supervisor.view import StateSink

_log = logging.getLogger(__name__)


class Publisher:
    """Passes every event to the sinks, with the view before and after it."""

    def __init__(self, *sinks: StateSink, stamp_ns: Callable[[], int] = time.time_ns) -> None:
        """Take the sinks; ``stamp_ns`` gives the wall-clock time in nanoseconds."""
        self._sinks = list(sinks)
        self.stamp_ns = stamp_ns
        self.view = SystemView()
        self._stop: StopRequests | None = None
        self._view_before_stop: SystemView | None = None
        self._warnings: set[str] = set()

    def add_sink(self, sink: StateSink) -> None:
        """Pass events to another sink, from now on."""
        self._sinks.append(sink)

    def is_news(self, warning: str) -> bool:
        """Whether a warning that may concern many units alike is logged for the first time."""
        if warning in self._warnings:
            return False
        self._warnings.add(warning)
        return True

    @property
    def view_before_stop(self) -> SystemView:
        """The view as it was when the first stop was requested, or is as long as none was."""
        return self._view_before_stop or self.view

    def remember_view_before(self, stop: StopRequests) -> None:
        """Keep the view as it is when a stop is requested, before the first event of the stop."""
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
            except Exception:  # noqa: BLE001 - a sink must not stop the unit
                self._sinks.remove(sink)
                _log.exception("%s failed and gets no more events", type(sink).__name__)

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
    """The first request stops the system in order; a second signal skips to the next stop signal.

    Several crashes of one moment may each request the stop, and so may a crash and a signal: these
    are no second signal.

    Belongs to the thread of the event loop: pass signals on with ``loop.call_soon_threadsafe``.
    """

    def __init__(self) -> None:
        self.requested = asyncio.Event()
        self.hurry = asyncio.Event()
        self.signum: int | None = None
        """The signal of the first request; None where it was none."""
        self.reason = ""
        self._signals = 0

    def request(self, signum: int | None = None, reason: str = "") -> None:
        """Request the stop; a second signal skips to the next stop signal."""
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
    if held is None:  # it has exited, which is reported anyway
        return
    for shortfall in shortfalls(wanted, held):
        text = f"{name}: {shortfall}"
        if publisher.is_news(text):
            _log.warning("%s", text)
