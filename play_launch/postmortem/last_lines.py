"""The latest lines of each logger, kept as they were recorded until they are requested.

An hour of a large system has millions of lines, of which a few dozen are read.
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Final

from play_launch.container.cdr.layout import CdrError
from play_launch.container.cdr.messages import read_log

if TYPE_CHECKING:
    from collections.abc import Iterator

    from play_launch.postmortem.bag_reader import Message

MOST: Final = 20
_QOS: Final = b"incompatible QoS"
"""In the warnings of rclcpp and rclpy about publishers and subscriptions that do not match."""
_MOST_QOS: Final = 1000
MOST_LOGGERS: Final = 500
"""Of a process, whose lines are kept: names of loggers may have numbers that count up."""
_NAME_AT: Final = 20
"""Where the first string stands, behind encapsulation, stamp, level and its length."""
_LOGGER_WITHIN: Final = 400
"""Bytes from the name on in which a line's logger stands, if anywhere."""
_LONGEST_LOGGER: Final = 255


class LastLines:
    """A ring for each process and each logger in it: the nodes of a container share its output."""

    def __init__(self) -> None:
        """Begin without lines."""
        self._rings: dict[bytes, dict[bytes, deque[Message]]] = {}
        self._qos: list[Message] = []

    def take(self, message: Message) -> None:
        """Keep a message of the output topic; one that is damaged is left out."""
        data = message.data
        end = data.find(0, _NAME_AT)
        if end < 0:
            return
        # ``[INFO] [time] [logger]: text``; a regular expression takes twice as long.
        stop = data.find(b"]: ", end, end + _LOGGER_WITHIN)
        begin = data.rfind(b"] [", end, stop) + 3 if stop > 0 else 0
        logger = data[begin:stop] if begin > 3 and stop - begin <= _LONGEST_LOGGER else b""
        name = data[_NAME_AT:end]
        rings = self._rings.get(name)
        if rings is None:
            rings = self._rings[name] = {}
        ring = rings.get(logger)
        if ring is None:
            if len(rings) >= MOST_LOGGERS:
                _forget_quiet(rings)
            ring = rings[logger] = deque(maxlen=MOST)
        ring.append(message)
        if _QOS in data and len(self._qos) < _MOST_QOS:
            self._qos.append(message)

    def qos_reports(self) -> Iterator[tuple[int, str]]:
        """Give the warnings about incompatible QoS, each with its log time."""
        return ((message.log_time, _text(message.data)) for message in self._qos)

    def of(self, container: str, name: str, until_ns: int) -> tuple[str, ...]:
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
            if line.log_time <= until_ns
        ]
        lines.sort(key=lambda line: line.log_time)
        return tuple(filter(None, (_text(line.data) for line in lines[-MOST:])))


def _forget_quiet(rings: dict[bytes, deque[Message]]) -> None:
    """Drop the half of the loggers that have not written for longest."""
    for logger in sorted(rings, key=lambda each: rings[each][-1].log_time)[: len(rings) // 2]:
        del rings[logger]


def _text(data: bytes) -> str:
    try:
        return read_log(data).message
    except CdrError:
        return ""
