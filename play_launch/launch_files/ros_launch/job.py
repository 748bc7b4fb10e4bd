"""Job and limits of the process that evaluates, and the head of its answer."""

from __future__ import annotations

import os
import resource
import struct
from typing import Final

from msgspec import Struct

SIZE: Final = struct.Struct("=Q")
"""The size of the answer, which stands before it: a fork of the launch file may hold the pipe."""


class Job(Struct, frozen=True, kw_only=True):
    """What is to be evaluated.

    `limit` is seconds. `only_arguments` reads the file without visiting it. `is_faster` evaluates
    with what `faster` replaces.
    """

    path: str
    arguments: tuple[tuple[str, str], ...] = ()
    temporary: str
    limit: float
    is_faster: bool = True
    only_arguments: bool = False


_LARGEST: Final = 4 * 2**30
"""Bytes; Autoware's largest launch files take some hundred MiB."""


def most_memory() -> int:
    """Return how many bytes of data the process may have: at most half of the machine's memory."""
    physical = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    return min(_LARGEST, physical // 2)


def bound_memory() -> None:
    """Have this process, and what it starts, fail to get more."""
    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    most = most_memory()
    if hard == resource.RLIM_INFINITY or most < hard:
        resource.setrlimit(resource.RLIMIT_DATA, (most, hard))
