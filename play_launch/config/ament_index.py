"""The prefixes of ROS packages."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping


def ament_prefixes(environ: Mapping[str, str]) -> list[Path]:
    """List the entries of AMENT_PREFIX_PATH."""
    return [
        Path(entry) for entry in environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if entry
    ]
