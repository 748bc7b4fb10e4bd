"""Durations, sizes, counts and names in texts for people."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

_BYTES: Final = (("TB", 10**12), ("GB", 10**9), ("MB", 10**6), ("kB", 10**3))


def duration(nanoseconds: int) -> str:
    """Write a duration: ``3 ms``, ``1.2 s``, ``12 s``, ``3 min 20 s``, ``2 h 5 min``."""
    seconds = nanoseconds / 1e9
    if seconds < 0.9995:
        return f"{seconds * 1000:.0f} ms"
    if seconds < 9.95:
        return f"{seconds:.1f} s"
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    if whole < 86400:
        return f"{whole // 3600} h {whole // 60 % 60} min"
    return f"{whole // 86400} d {whole // 3600 % 24} h"


def size(count: int) -> str:
    """Write a number of bytes in powers of ten: ``999 B``, ``12.3 MB``."""
    for unit, factor in _BYTES:
        if count >= factor * 0.9995:  # which rounds to one of the unit
            return f"{count / factor:{'.3g' if count < factor * 999.5 else '.0f'}} {unit}"
    return f"{count} B"


def counted(number: int, noun: str) -> str:
    """``1 node``, ``2 nodes``, ``3 processes``, ``4 crashes``."""
    plural = f"{noun}es" if noun.endswith(("s", "sh")) else f"{noun}s"
    return f"{number} {noun if number == 1 else plural}"


def listed(names: Sequence[str], most: int) -> str:
    """Name the first ones, and count the others: ``/a, /b and 3 more``."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return f"{', '.join(names[:most])}{more}"


def similar(name: str, known: Iterable[str]) -> str:
    """Return the known name that is most like this one, by the whole or by its last part, or ""."""
    from difflib import get_close_matches  # noqa: PLC0415 - for mistakes only

    names = {each: each for each in known}
    tails = {each.rpartition("/")[2]: each for each in names}
    for word, candidates in ((name, names), (name.rpartition("/")[2], tails)):
        if found := get_close_matches(word, candidates, 1):
            return candidates[found[0]]
    return ""
