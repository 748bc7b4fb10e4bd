"""What happened, in sentences: the first thing that a page shows."""

from __future__ import annotations

from msgspec import Struct


class Point(Struct, frozen=True):
    """One thing that happened."""

    title: str
    lines: tuple[str, ...] = ()
    """The first ones are shown at once."""
    at: float | None = None
    """Milliseconds since the start; None: no moment."""
    who: str = ""
    """Name of the node, container or process; empty: the machine."""
    is_failure: bool = True
