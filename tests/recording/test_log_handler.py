from __future__ import annotations

import logging
import threading
from typing import TYPE_CHECKING

from play_launch.recording.log_handler import MOST_WAITING, log_published

if TYPE_CHECKING:
    from play_launch.supervisor.events import LogRecord


def test_a_flood_of_other_loggers_is_bounded_and_what_is_dropped_is_counted() -> None:
    published: list[LogRecord] = []
    entered, gate = threading.Event(), threading.Event()

    def publish(record: LogRecord) -> None:
        published.append(record)
        if record.name == "another":
            entered.set()
            gate.wait()

    with log_published(publish):
        log = logging.getLogger("another")
        log.warning("the first one holds up the thread")
        entered.wait()
        for number in range(MOST_WAITING + 5):
            log.warning("%d", number)
        gate.set()
    assert sum(each.name == "another" for each in published) == 1 + MOST_WAITING
    assert any("5 records of other loggers are not recorded" in each.message for each in published)


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
