"""What is left of Fast DDS in /dev/shm, where other tests run at the same time."""

from __future__ import annotations

import re

from play_launch.fastdds.shared_memory import sweep


def ports_left_in(domain: int) -> set[str]:
    """Sweep, and return what dead participants of one domain had left.

    Only ports show by their number whose they are; who is killed leaves its ports with its segment.
    """
    first = 7400 + 250 * domain
    ports = {
        int(match[1]): name
        for name in sweep().removed
        if (match := re.fullmatch(r"fastrtps_port(\d+)", name))
    }
    return {name for port, name in ports.items() if first <= port < first + 250}
