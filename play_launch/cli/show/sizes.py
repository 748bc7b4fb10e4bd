"""Sizes for people."""

from __future__ import annotations

from typing import Final

_BYTES: Final = (("GB", 1_000_000_000), ("MB", 1_000_000), ("kB", 1_000))


def size(count: int) -> str:
    """Write a number of bytes for people, in powers of ten."""
    for unit, factor in _BYTES:
        if count >= factor:
            return f"{count / factor:.3g} {unit}"
    return f"{count} bytes"
