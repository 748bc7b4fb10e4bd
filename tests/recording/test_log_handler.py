from __future__ import annotations

import logging
import threading
from typing import TYPE_CHECKING

from play_launch.recording.log_handler import log_published

if TYPE_CHECKING:
    from play_launch.supervisor.events import LogRecord


def test_other_loggers_are_published_by_a_thread_that_holds_no_lock() -> None:
    """A destructor logs while its thread holds what `publish` takes."""
    published: list[LogRecord] = []
    taken = threading.Lock()

    def publish(record: LogRecord) -> None:
        with taken:
            published.append(record)

    with log_published(publish), taken:
        logging.getLogger("another").warning("in the midst of something")
    assert [(each.name, each.level) for each in published] == [("another", logging.WARNING)]
