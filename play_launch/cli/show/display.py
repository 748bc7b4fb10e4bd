"""Shows a run while it happens, without ever making it wait for a slow terminal."""

from __future__ import annotations

import contextlib
import logging
import sys
import threading
from typing import TYPE_CHECKING, Final, NamedTuple, Protocol

from msgspec import Struct

from play_launch.cli.output import redirect_to_devnull
from play_launch.supervisor.events import LogRecord, OutputLine, RunEvent
from play_launch.supervisor.view import SystemView

if TYPE_CHECKING:
    from collections.abc import Sequence

_log = logging.getLogger(__name__)
_NO_VIEW: Final = SystemView()

_LAST_WORDS: Final = 2.0
"""Seconds that the end waits for a terminal which takes no more."""


class Shown(NamedTuple):
    """An event and the view before and after it; a record of the log has none."""

    event: RunEvent
    before: SystemView
    after: SystemView


class Style(Protocol):
    """One way to show a run. All but :meth:`wants` is called in the display's thread."""

    def wants(self, event: RunEvent) -> bool:
        """Whether an event shows in this style; called for every event, so it must be quick."""

    def show(self, batch: Sequence[Shown], missed: int) -> float | None:
        """Show events; ``missed`` lines of output before the last of them are not among them.

        Returns the seconds after which to be called again even though nothing has happened, or
        None.
        """

    def close(self) -> None:
        """Leave the terminal as it was."""


class DisplayLimits(Struct, frozen=True):
    """Sizes and times of a display."""

    lines: int = 5_000
    """Lines of output waiting to be shown; further ones are left out and counted."""
    other_events: int = 100_000
    """Room for other events; it is used up only if stdout is not read."""
    batch: float = 0.05
    """Seconds between two writes."""


class Display:
    """Takes events on any thread and shows them from one of its own.

    A terminal can be stopped (Ctrl-S) and a pipe can be full; both would block the writing thread.
    When stdout takes no more (its reader has gone, the disk is full, the terminal was closed),
    showing ends, and the run goes on.
    """

    def __init__(self, style: Style, limits: DisplayLimits | None = None) -> None:
        """Start the thread."""
        self._style = style
        self._limits = limits or DisplayLimits()
        self._lock = threading.Lock()
        self._queue: list[Shown] = []
        self._missed = 0
        self._closing = False
        self._gone = False
        self._wake = threading.Event()
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run, name="display", daemon=True)
        self._thread.start()

    def publish(self, event: RunEvent, before: SystemView, after: SystemView) -> None:
        """Show an event soon; never blocks."""
        if self._gone or not self._style.wants(event):
            return
        room = self._limits.lines
        if not isinstance(event, OutputLine):
            room += self._limits.other_events
        with self._lock:
            waiting = len(self._queue)
            if self._closing or waiting >= room:
                self._missed += 1
                return
            self._queue.append(Shown(event, before, after))
        if not waiting:
            self._wake.set()

    def publish_log(self, event: LogRecord) -> None:
        """Show a record of the log, in any thread: it neither changes the view nor needs one."""
        self.publish(event, _NO_VIEW, _NO_VIEW)

    def close(self) -> None:
        """Show what is waiting and leave the terminal as it was."""
        with self._lock:
            self._closing = True
        self._end.set()
        self._wake.set()
        self._thread.join(_LAST_WORDS)

    def _run(self) -> None:
        again: float | None = 0.0
        try:
            while True:
                self._wake.wait(again)
                self._end.wait(self._limits.batch)
                self._wake.clear()
                with self._lock:
                    batch, self._queue = self._queue, []
                    missed, self._missed = self._missed, 0
                    closing = self._closing
                again = self._style.show(batch, missed)
                if closing:
                    return
        except OSError as error:
            # A terminal that was closed answers EIO; what follows for the run is up to SIGHUP.
            self._gone = True
            redirect_to_devnull(sys.stdout)
            if not isinstance(error, BrokenPipeError):
                _log.warning("the display is off: stdout cannot be written: %s", error.strerror)
        finally:
            # Also after a mistake of ours: the cursor must come back.
            with contextlib.suppress(OSError, ValueError):
                self._style.close()
