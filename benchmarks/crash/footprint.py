"""What a process holds, to see whether it grows."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True)
class Footprint:
    """`after`: so many crashes; memory in MB."""

    after: int
    memory: float
    threads: int
    descriptors: int
    mappings: int


def footprint(pid: int, after: int) -> Footprint | None:
    """Of a process, from /proc; None when it is gone."""
    folder = Path(f"/proc/{pid}")
    try:
        status = (folder / "status").read_text(encoding="ascii", errors="replace")
        fields = dict(line.split(":", 1) for line in status.splitlines())
        return Footprint(
            after=after,
            memory=int(fields["VmRSS"].split()[0]) * 1024 / 1e6,
            threads=int(fields["Threads"]),
            descriptors=len(os.listdir(folder / "fd")),  # noqa: PTH208
            mappings=(folder / "maps").read_bytes().count(b"\n"),
        )
    except (OSError, KeyError):
        return None


def growth(taken: Sequence[Footprint]) -> dict[str, float] | None:
    """From the first third of the footprints to the last, per 1,000 crashes.

    Each third is represented by its smallest value: what comes and goes is no growth. None when
    there are too few.
    """
    third = len(taken) // 3
    if third == 0:
        return None
    early, late = taken[:third], taken[-third:]
    crashes = late[0].after - early[0].after
    if crashes <= 0:
        return None
    return {
        name: (min(getattr(f, name) for f in late) - min(getattr(f, name) for f in early))
        * 1000
        / crashes
        for name in ("memory", "threads", "descriptors", "mappings")
    }
