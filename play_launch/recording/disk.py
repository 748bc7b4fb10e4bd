"""Forces a recording to the disk, in a thread that may wait for it."""

from __future__ import annotations

import math
import threading
import time
from typing import TYPE_CHECKING

from play_launch.recording.errors import WriteFailedError

if TYPE_CHECKING:
    from collections.abc import Callable

    from play_launch.recording.part import Part


class Disk:
    """Syncs what was written, at most ``period`` seconds after it was, and completes files.

    An SD card may take seconds for it, in which the recorder would not empty its queue. The thread
    begins with the first thing to do. ``on_error`` is called at once with the first error of each
    file; one of a job is kept for :meth:`close` as well.
    """

    def __init__(self, period: float, on_error: Callable[[Part, OSError], None]) -> None:
        """``period`` may be infinite: then a file is synced when it is complete."""
        self._period = period
        self._on_error = on_error
        self._changed = threading.Condition()
        self._dirty: Part | None = None
        self._due = math.inf
        self._jobs: list[tuple[Part, Callable[[], None]]] = []
        self._closing = False
        self._error: WriteFailedError | None = None
        self._failed: Part | None = None
        self._thread: threading.Thread | None = None

    def written(self, part: Part) -> None:
        """Note that a file has something new; never blocks."""
        if self._period == math.inf or self._dirty is part:
            return
        with self._changed:
            if self._dirty is None:
                self._due = time.monotonic() + self._period
            self._dirty = part
            self._wake()

    def do(self, part: Part, job: Callable[[], None]) -> None:
        """Have something done with a file after the jobs before; it may raise ``OSError``."""
        with self._changed:
            self._jobs.append((part, job))
            self._wake()

    def close(self) -> None:
        """Wait for the jobs; raise the first error of one. Nothing may follow."""
        with self._changed:
            self._closing = True
            self._changed.notify()
        if self._thread is not None:
            self._thread.join()
        if self._error is not None:
            raise self._error

    def _wake(self) -> None:
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, name="recorder-disk", daemon=True)
            self._thread.start()
        self._changed.notify()

    def _run(self) -> None:
        while True:
            with self._changed:
                while not self._jobs and not self._closing:
                    left = self._due - time.monotonic()
                    if left <= 0:
                        break
                    self._changed.wait(None if left == math.inf else left)
                if self._closing and not self._jobs:
                    return
                jobs, self._jobs = self._jobs, []
                part, self._dirty = self._dirty, None
                self._due = math.inf
            for one, job in jobs:
                self._carry_out(one, job)
            if part is not None and part.file.is_open:
                self._sync(part)

    def _carry_out(self, part: Part, job: Callable[[], None]) -> None:
        try:
            job()
        except OSError as error:
            self._error = self._error or WriteFailedError(part.path, error)
            if not self._closing:
                self._report(part, error)

    def _sync(self, part: Part) -> None:
        try:
            part.sync()
        except OSError as error:
            self._report(part, error)

    def _report(self, part: Part, error: OSError) -> None:
        if self._failed is not part:
            self._failed = part
            self._on_error(part, error)
