"""What is asked of the process that evaluates, and the head of its answer."""

from __future__ import annotations

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
