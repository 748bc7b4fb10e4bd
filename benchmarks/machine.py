"""What figures were measured on."""

from __future__ import annotations

import os
import platform
from typing import Any

from play_launch.container.environment import find_allocator


def machine() -> dict[str, Any]:
    allocator = find_allocator().library
    return {
        "cpus": os.cpu_count(),
        "kernel": platform.release(),
        "architecture": platform.machine(),
        "allocator": "the C library's" if allocator is None else allocator.name,
    }
