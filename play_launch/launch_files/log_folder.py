"""What `$(log_dir)` stands for."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping


def log_folder(environ: Mapping[str, str]) -> str:
    """Return the folder for ROS's log files: $ROS_LOG_DIR, else $ROS_HOME/log, else ~/.ros/log.

    launch makes a folder of its own in it at each start. A configuration is started many times, and
    is the same each time that it is written.
    """
    home = environ.get("ROS_HOME") or "~/.ros"
    return str(Path(environ.get("ROS_LOG_DIR") or f"{home}/log").expanduser().absolute())
