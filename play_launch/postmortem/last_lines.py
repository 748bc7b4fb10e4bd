"""The latest lines of each logger, kept as they were recorded until they are requested.

An hour of a large system has millions of lines, of which a few dozen are read.
"""

from __future__ import annotations

import re
from collections import deque
from struct import Struct
from typing import TYPE_CHECKING, Final

from play_launch.container.cdr.layout import CdrError
from play_launch.container.cdr.messages import LOG

if TYPE_CHECKING:
    from collections.abc import Iterator

    from play_launch.postmortem.bag_reader import Message

MOST: Final = 20
_QOS: Final = b"incompatible QoS"
"""In the warnings of rclcpp and rclpy about publishers and subscriptions that do not match."""
_MOST_QOS: Final = 1000
MOST_LOGGERS: Final = 500
"""Of a process, whose lines are kept: names of loggers may have numbers that count up."""
_NAME: Final = Struct("<I")
_NAME_AT: Final = 16
"""Where the length of the first string stands, behind encapsulation, stamp and level."""
_LOGGER: Final = re.compile(rb"\] \[([^\]\n]{1,255})\]: ")
_LOGGER_WITHIN: Final = 400
"""Bytes from the begin of a message in which a line's logger stands, if anywhere."""


class LastLines:
    """A ring for each process and each logger in it: the nodes of a container share its output."""

    def __init__(self) -> None:
        """Begin without lines."""
        self._rings: dict[bytes, dict[bytes, deque[Message]]] = {}
        self._qos: list[Message] = []

    def take(self, message: Message) -> None:
        """Keep a message of the output topic; one that is damaged is left out."""
        data = message.data
        if len(data) < _NAME_AT + _NAME.size:
            return
        (size,) = _NAME.unpack_from(data, _NAME_AT)
        begin = _NAME_AT + _NAME.size
        name = data[begin : begin + size - 1]
        found = _LOGGER.search(data, begin + size, _LOGGER_WITHIN + size)
        logger = found[1] if found else b""
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
        """Give the latest lines of a unit; ``container`` is empty for what is no node."""
        if container:
            return self.of_node(container, name, until_ns)
        return self.of_process(name, until_ns)

    def of_process(self, name: str, until_ns: int) -> tuple[str, ...]:
        """Give the latest lines of a process up to that moment."""
        return _latest(iter(self._rings.get(name.encode(), {}).values()), until_ns)

    def of_node(self, container: str, node: str, until_ns: int) -> tuple[str, ...]:
        """Give those of a node: by its loggers, and those of its container that name none."""
        own = node.removeprefix("/").replace("/", ".").encode()
        rings = self._rings.get(container.encode(), {})
        chosen = (
            ring
            for logger, ring in rings.items()
            if not logger or logger == own or logger.startswith(own + b".")
        )
        return _latest(chosen, until_ns)


def _forget_quiet(rings: dict[bytes, deque[Message]]) -> None:
    """Drop the half of the loggers that have not written for longest."""
    for logger in sorted(rings, key=lambda each: rings[each][-1].log_time)[: len(rings) // 2]:
        del rings[logger]


def _latest(rings: Iterator[deque[Message]], until_ns: int) -> tuple[str, ...]:
    lines = sorted(
        (line for ring in rings for line in ring if line.log_time <= until_ns),
        key=lambda line: line.log_time,
    )
    return tuple(filter(None, (_text(line.data) for line in lines[-MOST:])))


def _text(data: bytes) -> str:
    try:
        text: str = LOG.read(data)["msg"]
    except CdrError:
        return ""
    return text
