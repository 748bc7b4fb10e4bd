"""How many files the supervisor may have open; what it starts has the limit of its user.

A member takes up to four descriptors: a pidfd, two pipes and its channel. The soft limit is 1024
nearly everywhere, for the sake of programs that call select(2), which the supervisor does not and
nodes may; the hard one is meant for the others.
"""

from __future__ import annotations

import resource
from contextlib import suppress
from typing import Final

ENOUGH: Final = 65536
"""Where the hard limit is higher: systems are smaller, and tables in the kernel grow."""

_given: list[tuple[int, int]] = []
"""What the user had, if it was raised."""


def raise_limit() -> None:
    """Raise the soft limit as far as it may be; what runs already keeps its own."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = higher(soft, hard)
    if wanted is None:
        return
    with suppress(OSError, ValueError):  # the hard one may be above fs.nr_open
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))
        _given.append((soft, hard))


def higher(soft: int, hard: int) -> int | None:
    """Give the soft limit to ask for; None where it is high enough, or may not be raised."""
    unlimited = resource.RLIM_INFINITY
    wanted = ENOUGH if hard == unlimited else min(hard, ENOUGH)
    return None if soft == unlimited or soft >= wanted else wanted


def give_back(pid: int) -> None:
    """Have a process that inherited the raised limit, and what it starts, be as the user wants."""
    if _given:
        with suppress(OSError):  # it has ended
            resource.prlimit(pid, resource.RLIMIT_NOFILE, _given[0])
