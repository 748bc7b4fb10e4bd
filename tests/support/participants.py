"""A pytest plugin: participants of Fast DDS in test processes come to an end.

Where a participant goes while a discovery callback runs, Fast DDS of the ROS wheels may wait in a
loop that keeps the mutex from that callback, and rclpy holds Python's lock meanwhile: a test
process then hangs beyond the reach of any time limit. Our own programs define the function that it
waits with anew (`container_native/src/overrides/condition_deadline.cpp`); pytest-xdist's processes
preload the same definition, and hand it on to nobody.
"""

from __future__ import annotations

import os
import subprocess
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

_SOURCES = Path(__file__).resolve().parents[2] / "container_native" / "src"
_PRELOADED = "PLAY_LAUNCH_TESTS_PRELOAD"
"""Environment variable: what a process of pytest-xdist takes from its LD_PRELOAD."""


def _built(folder: Path) -> Path:
    library = folder / "condition_deadline.so"
    source = _SOURCES / "overrides" / "condition_deadline.cpp"
    compiler = os.environ.get("CXX", "c++")
    options = ["-std=c++20", "-O2", "-shared", "-fPIC", f"-I{_SOURCES}", "-o", str(library)]
    subprocess.run([compiler, *options, str(source)], check=True)
    return library


def pytest_configure(config: pytest.Config) -> None:
    """Have the processes preload it; in one of them, let its children be."""
    if hasattr(config, "workerinput"):
        _forget()
    elif config.getoption("numprocesses", None):
        folder = TemporaryDirectory(prefix="play-launch-tests-")
        config.add_cleanup(folder.cleanup)
        library = os.environ[_PRELOADED] = str(_built(Path(folder.name)))
        config.add_cleanup(_forget)
        os.environ["LD_PRELOAD"] = ":".join([library, *_preloads()])


def _preloads() -> list[str]:
    return [each for each in os.environ.get("LD_PRELOAD", "").split(":") if each]


def _forget() -> None:
    library = os.environ.pop(_PRELOADED, None)
    left = [each for each in _preloads() if each != library]
    os.environ.pop("LD_PRELOAD", None)
    if left:
        os.environ["LD_PRELOAD"] = ":".join(left)
