"""How much memory an evaluation may take: a launch file that takes without end ends itself only."""

from __future__ import annotations

import os
import resource
from typing import Final

_LARGEST: Final = 4 * 2**30
"""Bytes; Autoware's largest launch files take some hundred MiB."""


def most_memory() -> int:
    """Return how many bytes of data the process may have: at most half of the machine's memory."""
    physical = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    return min(_LARGEST, physical // 2)


def bound() -> None:
    """Have this process, and what it starts, fail to get more."""
    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    most = most_memory()
    if hard == resource.RLIM_INFINITY or most < hard:
        resource.setrlimit(resource.RLIMIT_DATA, (most, hard))
