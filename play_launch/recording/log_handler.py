"""The supervisor's own log as events, so that it is recorded like everything else."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, Final

from play_launch.core.events import LogRecord

if TYPE_CHECKING:
    from collections.abc import Callable

LOGGER_NAME: Final = "play_launch"
"""The logger above all of this package's."""

_NANOSECONDS: Final = 1_000_000_000
_HIGHEST: Final = 50


class EventLogHandler(logging.Handler):
    """Turns each record of Python's logging into a :class:`LogRecord`.

    ``logging`` calls a handler in whatever thread logs, and so ``publish`` must be callable from
    any thread.
    """

    def __init__(self, publish: Callable[[LogRecord], None], level: int = logging.DEBUG) -> None:
        """``level`` is the lowest one to pass on."""
        super().__init__(level)
        self._publish = publish

    def emit(self, record: logging.LogRecord) -> None:
        """Publish one record; a record that cannot be formatted is reported on stderr."""
        try:
            message = record.getMessage()
            if record.exc_info:
                message = f"{message}\n{_FORMATTER.formatException(record.exc_info)}"
            event = LogRecord(
                stamp_ns=int(record.created * _NANOSECONDS),
                level=_ros_level(record.levelno),
                name=record.name,
                message=message,
                file=record.filename,
                function=record.funcName or "",
                line=record.lineno,
            )
        except Exception:  # noqa: BLE001 - logging must never break what it reports on
            self.handleError(record)
        else:
            self._publish(event)


_FORMATTER: Final = logging.Formatter()


def _ros_level(level: int) -> int:
    """The next lower level that ROS knows: Python's are the same, with free numbers between."""
    return min(max(level // 10 * 10, logging.DEBUG), _HIGHEST)
