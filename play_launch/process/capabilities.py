"""Capabilities of this process, see capabilities(7)."""

from __future__ import annotations

import re
from enum import IntEnum
from pathlib import Path


class Capability(IntEnum):
    """Numbers of the capabilities that are asked about."""

    IPC_LOCK = 14
    SYS_NICE = 23


def has_capability(capability: Capability) -> bool:
    """Whether it is effective; False where that cannot be read."""
    try:
        status = Path("/proc/self/status").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return False
    found = re.search(r"^CapEff:\s*([0-9a-f]+)$", status, re.MULTILINE)
    return found is not None and bool(int(found[1], 16) >> capability & 1)
