"""The latest lines of each logger, kept as they were recorded until they are requested.

An hour of a large system has millions of lines, of which a few dozen are read.
"""

from __future__ import annotations

import heapq
import math
from collections import deque
from itertools import count
from operator import itemgetter
from typing import TYPE_CHECKING, Final, TypeAlias

from play_launch.container.cdr.messages import read_log
from play_launch.container.cdr.structure import CdrError
from play_launch.postmortem.mcap_records import (
    LATEST,
    MESSAGE,
    MESSAGE_KIND,
    NUMBER_AT,
    RECORD,
    Taken,
)

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from play_launch.postmortem.bag_reader import ChannelInfo
    from play_launch.postmortem.units import Failure, Unit

MOST: Final = 20
_QOS: Final = b"incompatible QoS"
"""In the warnings of rclcpp and rclpy about publishers and subscriptions that do not match."""
_MOST_QOS: Final = 1000
MOST_LOGGERS: Final = 500
"""Of a process, whose lines are kept: names of loggers may have numbers that count up."""
LATE_LINES: Final = 200_000_000
"""Nanoseconds that the last lines of a process may take to the recording."""
_EARLY: Final = 10_000_000
"""Nanoseconds that the first ones may be there before the event of its start."""
_NAME_AT: Final = 20
"""Where the first string stands, behind encapsulation, stamp, level and its length."""
_LOGGER_WITHIN: Final = 400
"""Bytes from the name on in which a line's logger stands, if anywhere."""
_LONGEST_LOGGER: Final = 255
_Line: TypeAlias = "tuple[int, bytes]"
"""Log time and message."""


class LastLines:
    """A ring for each process and each logger in it: the nodes of a container share its output."""

    def __init__(self) -> None:
        self._rings: dict[bytes, dict[bytes, deque[_Line]]] = {}
        self._qos: list[_Line] = []
        self._waiting: list[tuple[int, int, Failure]] = []
        """Failures whose last lines may still come, and until when."""
        self._order = count()

    def take(self, data: bytes, begin: int, channels: Mapping[int, ChannelInfo]) -> Taken:
        """Take the lines of a chunk that begin there; one that is damaged is left out."""
        number = data[begin + NUMBER_AT : begin + NUMBER_AT + 2]
        count, at, latest, size, head = 0, begin, 0, len(data), MESSAGE.size
        unpack, find, rfind = MESSAGE.unpack_from, data.find, data.rfind
        has_qos, waiting, rings = _QOS in data, self._waiting, self._rings
        # Without further calls: these are a third of the messages of a long session.
        while (
            size - at > head
            and data[at] == MESSAGE_KIND
            and data.startswith(number, at + NUMBER_AT)
        ):
            _, length, _, _, log_time, _ = unpack(data, at)
            text_at, end = at + head, at + RECORD.size + length
            if not text_at <= end <= size:
                break
            count, at = count + 1, end
            if latest < log_time <= LATEST:
                latest = log_time
            if waiting and waiting[0][0] < log_time:
                self._answer(log_time)
            name_at = text_at + _NAME_AT
            name_end = find(0, name_at, end)
            if name_end < 0:
                continue
            # ``[INFO] [time] [logger]: text``; a regular expression takes twice as long.
            stop = find(b"]: ", name_end, min(end, name_end + _LOGGER_WITHIN))
            logger_at = rfind(b"] [", name_end, stop) + 3 if stop > 0 else 0
            is_logger = logger_at > 3 and stop - logger_at <= _LONGEST_LOGGER
            name, logger = data[name_at:name_end], data[logger_at:stop] if is_logger else b""
            line = log_time, data[text_at:end]
            try:
                rings[name][logger].append(line)
            except KeyError:
                self._new_ring(name, logger).append(line)
            if has_qos and _QOS in line[1] and len(self._qos) < _MOST_QOS:
                self._qos.append(line)
        channels[int.from_bytes(number, "little")].count += count
        return Taken(at, latest)

    def _new_ring(self, name: bytes, logger: bytes) -> deque[_Line]:
        rings = self._rings.setdefault(name, {})
        if len(rings) >= MOST_LOGGERS:
            _forget_quiet(rings)
        return rings.setdefault(logger, deque(maxlen=MOST))

    def request(self, failure: Failure) -> None:
        """Give a failure its last lines as soon as all have come."""
        until = failure.log_time + LATE_LINES
        heapq.heappush(self._waiting, (until, next(self._order), failure))

    def settle(self, failure: Failure) -> None:
        """Give a failure its last lines: its unit starts again, and other lines follow."""
        if any(each[2] is failure for each in self._waiting):
            self._waiting = [each for each in self._waiting if each[2] is not failure]
            heapq.heapify(self._waiting)
            self._give(failure, math.inf)

    def end(self) -> None:
        """Give all failures their last lines: none comes any more."""
        self._answer(math.inf)

    def _answer(self, before: float) -> None:
        while self._waiting and self._waiting[0][0] < before:
            until, _, failure = heapq.heappop(self._waiting)
            self._give(failure, until)

    def _give(self, failure: Failure, until: float) -> None:
        since = failure.life_ns - _EARLY
        failure.last_lines = self.of(failure.container, failure.name, until, since)

    def of_life(self, unit: Unit, until_ns: int) -> tuple[str, ...]:
        """Give the latest lines of the latest life of a unit, up to a moment."""
        until, since = until_ns + LATE_LINES, unit.life_ns - _EARLY
        return self.of(unit.container, unit.name, until, since)

    def qos_reports(self) -> Iterator[tuple[int, str]]:
        """Give the warnings about incompatible QoS, each with its log time."""
        return ((log_time, _text(data)) for log_time, data in self._qos)

    def of(self, container: str, name: str, until_ns: float, since_ns: int = 0) -> tuple[str, ...]:
        """Give the latest lines of a unit up to a moment; ``container`` is empty but for nodes.

        Of a node these are those of its loggers, and those of its container that name none.
        """
        rings = self._rings.get((container or name).encode(), {})
        own = name.removeprefix("/").replace("/", ".").encode()
        lines = [
            line
            for logger, ring in rings.items()
            if not (container and logger) or logger == own or logger.startswith(own + b".")
            for line in ring
            if since_ns <= line[0] <= until_ns
        ]
        lines.sort(key=itemgetter(0))
        return tuple(filter(None, (_text(data) for _, data in lines[-MOST:])))


def _forget_quiet(rings: dict[bytes, deque[_Line]]) -> None:
    """Drop the half of the loggers that have not written for longest."""
    for logger in sorted(rings, key=lambda each: rings[each][-1][0])[: len(rings) // 2]:
        del rings[logger]


def _text(data: bytes) -> str:
    try:
        return read_log(data).message
    except CdrError:
        return ""
