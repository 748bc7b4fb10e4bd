"""The supervisor's own log as events, so that it is recorded and shown like everything else.

What Python itself reports goes the same way, where it would be printed on stderr, across the live
view, and be missing from the recording: errors in callbacks and tasks of asyncio, exceptions in
threads and destructors, warnings.
"""

from __future__ import annotations

import contextlib
import logging
import sys
import threading
from logging.handlers import QueueHandler, QueueListener
from queue import SimpleQueue
from typing import TYPE_CHECKING, Final

from play_launch.supervisor.events import LogRecord

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

LOGGER_NAME: Final = "play_launch"
"""The logger above all of this package's."""

REPORTED_LOGGER: Final = "play_launch.reported"
"""Logger for what an event reports as well: recorded, but shown once only."""

MOST_WAITING: Final = 10_000
"""Records of other loggers that wait to be published."""

_log = logging.getLogger(__name__)
_python_log = logging.getLogger("python")


@contextlib.contextmanager
def log_published(publish: Callable[[LogRecord], None]) -> Iterator[None]:
    """Publish all that is logged, and print none of it.

    Our own log comes in full and in the thread that logs; that of other loggers (asyncio's,
    Python's warnings, uncaught exceptions) from WARN on and from a thread of its own. ``publish``
    must be callable from any thread.
    """
    ours, root = logging.getLogger(LOGGER_NAME), logging.getLogger()
    handler = EventLogHandler(publish)
    # Destructors log in the midst of anything, perhaps while their thread holds a lock that
    # `publish` takes. The queue may be entered at any time, also a second time by one thread.
    queue: SimpleQueue[logging.LogRecord] = SimpleQueue()
    listener = QueueListener(queue, handler)
    listener.start()
    others = _BoundedQueueHandler(queue)
    before = ours.level, ours.propagate, sys.unraisablehook, threading.excepthook
    ours.addHandler(handler)
    root.addHandler(others)
    ours.setLevel(logging.DEBUG)
    ours.propagate = False
    logging.captureWarnings(capture=True)
    sys.unraisablehook, threading.excepthook = _log_unraisable, _log_end_of_thread
    try:
        yield
        if others.dropped:
            _log.warning("%d records of other loggers are not recorded", others.dropped)
    finally:
        logging.captureWarnings(capture=False)
        root.removeHandler(others)
        ours.removeHandler(handler)
        ours.level, ours.propagate, sys.unraisablehook, threading.excepthook = before
        listener.stop()


class _BoundedQueueHandler(QueueHandler):
    """Drops and counts what comes faster than it is published."""

    def __init__(self, waiting: SimpleQueue[logging.LogRecord]) -> None:
        super().__init__(waiting)
        self.dropped = 0
        self._waiting = waiting

    def enqueue(self, record: logging.LogRecord) -> None:
        if self._waiting.qsize() >= MOST_WAITING:
            self.dropped += 1
        else:
            super().enqueue(record)


def _log_unraisable(unraisable: sys.UnraisableHookArgs) -> None:
    error = unraisable.exc_value or unraisable.exc_type()
    words = unraisable.err_msg or "Exception ignored in"
    _python_log.error(
        "%s: %r", words, unraisable.object, exc_info=(type(error), error, unraisable.exc_traceback)
    )


def _log_end_of_thread(end: threading.ExceptHookArgs) -> None:
    if issubclass(end.exc_type, SystemExit):  # the usual way to end a thread
        return
    error = end.exc_value or end.exc_type()
    name = end.thread.name if end.thread else "?"
    _python_log.error(
        "Exception in thread %s", name, exc_info=(type(error), error, end.exc_traceback)
    )


class EventLogHandler(logging.Handler):
    """Turns each record of Python's logging into a :class:`LogRecord`.

    ``logging`` calls a handler in whatever thread logs, and so ``publish`` must be callable from
    any thread.
    """

    def __init__(self, publish: Callable[[LogRecord], None]) -> None:
        super().__init__()
        self._publish = publish

    def emit(self, record: logging.LogRecord) -> None:
        """Publish one record; a record that cannot be formatted is reported on stderr."""
        try:
            event = LogRecord(
                stamp_ns=int(record.created * 1e9),
                # The next lower level that ROS knows: Python has free numbers between them.
                level=min(max(record.levelno // 10 * 10, logging.DEBUG), logging.FATAL),
                name=record.name,
                message=self.format(record).rstrip(),
                file=record.filename,
                function=record.funcName or "",
                line=record.lineno,
            )
        except Exception:  # noqa: BLE001 - logging must never break what it reports on
            self.handleError(record)
        else:
            self._publish(event)
