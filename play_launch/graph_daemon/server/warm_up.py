"""When the graph is known well enough to be asked: it is at rest, and nobody is missing.

A participant that joins a domain meets the others one by one, some only after three seconds, and
nothing in the graph shows that somebody is still missing. But every participant binds UDP ports of
its own, by a rule that RTPS fixes (section 9.6.1.1), so the kernel's table of sockets gives their
number.
"""

from __future__ import annotations

from collections import deque
from pathlib import Path
from typing import Final, NamedTuple

QUIET: Final = 0.5
"""Seconds without a change after which the graph counts as settled."""
LONGEST_WARM_UP: Final = 5.0
"""Seconds after which answers are given in any case; a storm may last for minutes."""
WINDOW: Final = 10.0
"""Seconds over which changes are counted."""
LOOK_AGAIN: Final = 0.1
"""Seconds until a graph that is quiet, but not complete, is looked at again."""

_TABLE: Final = Path("/proc/net/udp")
_BASE: Final = 7400
_PER_DOMAIN: Final = 250
_FIRST: Final = 10
"""Offset of the first participant's port for unicast discovery; those of the others are even."""
MOST: Final = (_PER_DOMAIN - _FIRST) // 2
"""With more participants their ports reach into those of the next domain."""


class Pulse:
    """Folds the times of changes; all times are seconds of one clock that never jumps.

    A node that has just joined knows nobody yet, so its first answers would be empty lists. It is
    warm when discovery has paused for `QUIET` and nobody is known to be missing, or when
    `LONGEST_WARM_UP` is over.
    """

    def __init__(self, started: float) -> None:
        self._started = started
        self._last = started
        self._changes: deque[float] = deque()

    @property
    def deadline(self) -> float:
        """When it is warm in any case."""
        return self._started + LONGEST_WARM_UP

    def change(self, now: float) -> None:
        """The graph changed."""
        self._last = max(self._last, now)
        self._changes.append(now)
        self._forget(now)

    def is_warm(self, now: float, *, complete: bool) -> bool:
        """Whether answers may be given; ``complete`` says that nobody is known to be missing."""
        return now >= self.deadline or (complete and self.is_quiet(now))

    def look_again_at(self, now: float) -> float:
        """Return when it may be warm next; later than ``now``."""
        return min(max(self._last + QUIET, now + LOOK_AGAIN), max(self.deadline, now + LOOK_AGAIN))

    def is_quiet(self, now: float) -> bool:
        """Whether nothing has changed for a while."""
        return now - self._last >= QUIET

    def quiet_for(self, now: float) -> float:
        """Return the seconds since the last change."""
        return max(0.0, now - self._last)

    def rate(self, now: float) -> float:
        """Return the changes per second, over the last `WINDOW` or since the start."""
        self._forget(now)
        return len(self._changes) / max(1.0, min(WINDOW, now - self._started))

    def _forget(self, now: float) -> None:
        while self._changes and self._changes[0] <= now - WINDOW:
            self._changes.popleft()


class Population(NamedTuple):
    """Who is in the graph, and who should be."""

    nodes: int
    """Nodes without the daemon's own."""
    participants: int
    participants_here: int
    nameless: int
    """Publishers whose nodes are not known yet."""

    @property
    def is_complete(self) -> bool:
        """Whether nobody is known to be missing."""
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
