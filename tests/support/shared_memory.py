"""What participants of Fast DDS have in /dev/shm, where other tests run at the same time."""

from __future__ import annotations

import re
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from play_launch.ros.fastdds.shared_memory import SHARED_MEMORY, sweep


def segments_of(pids: Iterable[int]) -> set[Path]:
    """Return the segments of these processes, by the lock files that they hold.

    Without those of ports, which the next process takes over; a segment's name is given once.
    """
    found = set()
    for pid in pids:
        with suppress(OSError):  # it ends meanwhile
            for entry in Path(f"/proc/{pid}/fd").iterdir():
                with suppress(FileNotFoundError):  # closed since
                    lock = entry.readlink()
                    if match := re.fullmatch(r"(fast(?:rtps|dds)_[0-9a-f]{16})_el", lock.name):
                        found.add(SHARED_MEMORY / match[1])
    return found


def ports_left_in(domain: int) -> set[str]:
    """Sweep, and return what dead participants of one domain had left.

    Only ports show their owner by their number; a killed process leaves its ports with its segment.
    """
    first = 7400 + 250 * domain
    ports = {
        int(match[1]): name
        for name in sweep().removed
        if (match := re.fullmatch(r"fast(?:rtps|dds)_port(\d+)", name))
    }
    return {name for port, name in ports.items() if first <= port < first + 250}
