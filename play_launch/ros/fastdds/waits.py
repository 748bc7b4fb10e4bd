"""Participants of this Python process come to an end, and do not wait for themselves.

Where a participant goes while one of its discovery callbacks runs, Fast DDS of the ROS wheels may
wait in a loop that keeps the mutex from that callback, for seconds or without end, and rclpy holds
Python's lock meanwhile: nothing of the process goes on. The cause is a deadline that overflows
(``overrides/condition_deadline.cpp`` of the container's sources). And where a reader in shared
memory dies in the midst of a message, a writer may wait for itself without end
(``overrides/owned_lock.cpp``). Our native programs define the functions that Fast DDS waits with
anew; here they are replaced in the Fast DDS that is loaded.
"""

from __future__ import annotations

import ctypes
import logging
import os
import sys
from pathlib import Path
from typing import Final

from play_launch.config.substitutions import ament_prefixes

_log = logging.getLogger(__name__)

_LIBRARY: Final = Path("lib") / "play_launch_container" / "libpython_waits.so"
_FASTDDS: Final = ("libfastrtps.so", "libfastdds.so")
"""How the file of Fast DDS begins, of version 2 and later ones."""


def end_participants_safely(libraries: tuple[str, ...] = _FASTDDS) -> int:
    """Replace the waits in the libraries that are loaded, so after the middleware's.

    Does nothing with another middleware, and where our own library is not installed.

    Args:
        libraries: How their file names begin.

    Returns:
        In how many it was replaced.
    """
    for prefix in (Path(sys.prefix), *ament_prefixes(os.environ)):
        path = prefix / _LIBRARY
        try:
            native = ctypes.CDLL(os.fspath(path))
        except OSError as error:
            if path.exists():
                _log.debug("%s cannot be loaded: %s", path, error)
            continue
        return sum(native.play_launch_replace_waits(os.fsencode(name)) for name in libraries)
    return 0
