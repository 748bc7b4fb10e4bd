"""Display of a run in a thread of its own: a slow terminal never delays the run."""

from __future__ import annotations

import contextlib
import logging
import sys
import threading
from typing import TYPE_CHECKING, Final, NamedTuple

from play_launch.cli.output import redirect_to_devnull
from play_launch.supervisor.events import LogRecord, OutputLine, RunEvent, Sample
from play_launch.supervisor.view import SystemView

if TYPE_CHECKING:
    from collections.abc import Sequence

_log = logging.getLogger(__name__)
_NO_VIEW: Final = SystemView()
_LINES_LIMIT: Final = 5_000
"""Lines of output waiting to be shown; further ones are left out and counted."""
_OTHERS_LIMIT: Final = 100_000
"""Room for other events; it is used up only if stdout is not read."""
_INTERVAL: Final = 0.05
"""Seconds between two writes."""
_CLOSE_TIMEOUT: Final = 2.0
"""Seconds for the last events at the end of the run."""


class Shown(NamedTuple):
    """An event and the view before and after it; a record of the log has none."""

    event: RunEvent
    before: SystemView
    after: SystemView


class Style:
    """One way to show a run; called in the display's thread."""

    def show(self, batch: Sequence[Shown], missed: int) -> float | None:
        """Show events; ``missed`` lines of output before the last of them are not among them.

        Returns the seconds after which to be called again even though nothing has happened, or
        None.
        """
        raise NotImplementedError

    def close(self) -> None:
        """Restore the terminal."""


class Display:
    """Shows events of any thread, samples excepted, and without output where ``quiet``.

    A terminal can be stopped (Ctrl-S) and a pipe can be full; both would block the writing thread.
    When a write to stdout fails (its reader has exited, the disk is full, the terminal was closed),
    the display ends, and the run continues.
    """

    def __init__(self, style: Style, *, quiet: bool = False) -> None:
        self._style = style
        self._hidden = (Sample, OutputLine) if quiet else Sample
        self._lock = threading.Lock()
        self._queue: list[Shown] = []
        self._missed = 0
        self._closing = False
        self._is_off = False
        self._wake = threading.Event()
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run, name="display", daemon=True)
        self._thread.start()

    def publish(self, event: RunEvent, before: SystemView, after: SystemView) -> None:
        """Show an event soon; never blocks."""
        if self._is_off or isinstance(event, self._hidden):
            return
        room = _LINES_LIMIT + (0 if isinstance(event, OutputLine) else _OTHERS_LIMIT)
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
        """Show waiting events and restore the terminal."""
        with self._lock:
            self._closing = True
        self._end.set()
        self._wake.set()
        self._thread.join(_CLOSE_TIMEOUT)

    def _run(self) -> None:
        again: float | None = 0.0
        try:
            while True:
                self._wake.wait(again)
                self._end.wait(_INTERVAL)
                self._wake.clear()
                with self._lock:
                    batch, self._queue = self._queue, []
                    missed, self._missed = self._missed, 0
                    closing = self._closing
                again = self._style.show(batch, missed)
                if closing:
                    return
        except OSError as error:
            # A closed terminal answers EIO; SIGHUP decides about the run.
            self._is_off = True
            redirect_to_devnull(sys.stdout)
            if not isinstance(error, BrokenPipeError):
                _log.warning("the display is off: stdout cannot be written: %s", error.strerror)
        finally:
            # Also after an exception: the cursor must be visible again.
            with contextlib.suppress(OSError, ValueError):
                self._style.close()
