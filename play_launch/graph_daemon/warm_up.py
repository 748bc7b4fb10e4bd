"""When the graph is known well enough to be queried: it is quiet, and no participant is missing.

A participant that joins a domain discovers the others one by one, some only after three seconds,
and nothing in the graph shows that one is still missing. But every participant binds UDP ports of
its own, by a rule that RTPS fixes (section 9.6.1.1), so the kernel's table of sockets gives their
number.
"""

from __future__ import annotations

import ipaddress
import socket
from collections import deque
from pathlib import Path
from typing import Final, NamedTuple

import psutil

QUIET: Final = 0.5
"""Seconds without a change after which the graph counts as settled."""
LONGEST_WARM_UP: Final = 5.0
"""Seconds after which answers are given in any case; a storm may last for minutes."""
WINDOW: Final = 10.0
"""Seconds over which changes are counted."""

_TABLE: Final = Path("/proc/net/udp")
_BASE: Final = 7400
_PER_DOMAIN: Final = 250
_FIRST: Final = 10
"""Offset of the first participant's port for unicast discovery; those of the others are even."""
MOST: Final = (_PER_DOMAIN - _FIRST) // 2
"""With more participants their ports reach into those of the next domain."""


class Pulse:
    """Times of the graph's changes, in seconds of one clock that never jumps."""

    def __init__(self, started: float) -> None:
        self._started = started
        self._last = started
        self._changes: deque[float] = deque()

    def change(self, now: float) -> None:
        self._last = max(self._last, now)
        self._changes.append(now)
        self._drop_old(now)

    def is_overdue(self, now: float) -> bool:
        return now - self._started >= LONGEST_WARM_UP

    def is_quiet(self, now: float) -> bool:
        return now - self._last >= QUIET

    def quiet_for(self, now: float) -> float:
        return max(0.0, now - self._last)

    def rate(self, now: float) -> float:
        """Return the changes per second, over the last `WINDOW` or since the start."""
        self._drop_old(now)
        return len(self._changes) / max(1.0, min(WINDOW, now - self._started))

    def _drop_old(self, now: float) -> None:
        while self._changes and self._changes[0] <= now - WINDOW:
            self._changes.popleft()


class Population(NamedTuple):
    """Numbers of nodes and participants in the graph, and of those expected."""

    nodes: int
    """Nodes without the daemon's own."""
    participants: int
    """Participants that the daemon's knows, itself included; 0 where they are hidden."""
    participants_here: int
    nameless: int
    """Publishers whose nodes are not known yet."""

    @property
    def is_complete(self) -> bool:
        """Whether no participant is known to be missing."""
        return not self.nameless and (
            not self.participants or self.participants >= self.participants_here
        )


def count_participants(table: str, domain: int) -> int:
    """Count the participants of ``domain`` in a table like ``/proc/net/udp``; 120 at most.

    Those whose profile gives them other ports, and those of other machines and network
    namespaces, are not there.
    """
    first = _BASE + _PER_DOMAIN * domain + _FIRST
    wanted = range(first, first + 2 * MOST, 2)
    ports = set()
    for line in table.splitlines():
        fields = line.split()
        # The local address, in hexadecimal digits.
        address, colon, port = fields[1].rpartition(":") if len(fields) > 3 else ("", "", "")
        if colon and address:
            try:
                ports.add(int(port, 16))
            except ValueError:
                continue
    return sum(port in ports for port in wanted)


def participants_here(domain: int) -> int:
    """Count the participants of ``domain`` in this network namespace; 0 where they are hidden."""
    try:
        table = _TABLE.read_text(encoding="ascii")
    except (OSError, UnicodeDecodeError):
        return 0
    return count_participants(table, domain)


def addresses() -> frozenset[tuple[str, str]]:
    """List interfaces and IP addresses of this network namespace, link-local ones left out.

    A DDS participant uses those that it found when it was made. Empty where they are hidden.
    """
    try:
        interfaces = psutil.net_if_addrs()
    except OSError:
        return frozenset()
    return frozenset(
        (interface, found.address)
        for interface, entries in interfaces.items()
        for found in entries
        if found.family in {socket.AF_INET, socket.AF_INET6}
        and not ipaddress.ip_address(found.address).is_link_local
    )
