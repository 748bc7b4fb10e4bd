"""A pytest plugin: which test may run when, where pytest-xdist spreads the tests over processes.

Tests run side by side, except those with the marker `alone`: while one of them runs, the other
processes wait between two tests. Without pytest-xdist nothing is done.
"""

from __future__ import annotations

import fcntl
import os
from collections.abc import Generator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest

from tests.support.waiting import until

WORKERS_PER_PROCESSOR = 2
"""Most tests wait more than they compute: for discovery, for time limits, for processes to end."""
MOST_WORKERS = 8
"""More make no suite faster: what is left then is what runs alone."""
_MARKER = (
    "alone: run while no other test runs, because it counts what all processes of the machine "
    "share (Fast DDS's segments in /dev/shm), or has limits that a busy machine exceeds"
)
_INPUT = "play_launch_turns"
LONGEST = (
    "tests/packaging/test_native_programs.py",
    "tests/style/test_style.py",
    "tests/integration/test_apply.py",
    "tests/container/test_crashes.py",
    "tests/container/test_growth.py",
    "tests/integration/test_crash_isolation.py",
    "tests/integration/test_stock_containers.py",
    "tests/integration/test_incidents.py",
    "tests/integration/test_samples.py",
    "tests/integration",
    "tests/container",
    "tests/control",
    "tests/simulation",
    "tests/cli/top",
)
"""Files and folders that take longest; begun first, so that all workers finish at the same time."""


class Turns:
    """The place of one process among those that share a folder.

    Two locks, which the kernel releases when their process ends, however it ends: the room, that
    many share or one has alone, and a gate before it. A test that waits for the room holds the
    gate, so that none overtakes one that waits to be alone.
    """

    def __init__(self, folder: Path) -> None:
        flags = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC
        self._gate = os.open(folder / "gate", flags, 0o600)
        self._room = os.open(folder / "room", flags, 0o600)
        self._is_alone = False

    def enter(self, *, alone: bool) -> None:
        """Wait for the room; a test that has it alone may enter alone again."""
        if alone and self._is_alone:
            return
        # Two that exchange their share for the whole would wait for each other.
        self.leave()
        fcntl.flock(self._gate, fcntl.LOCK_EX)
        fcntl.flock(self._room, fcntl.LOCK_EX if alone else fcntl.LOCK_SH)
        fcntl.flock(self._gate, fcntl.LOCK_UN)
        self._is_alone = alone

    def leave(self) -> None:
        """Let others in."""
        fcntl.flock(self._room, fcntl.LOCK_UN)
        self._is_alone = False

    def close(self) -> None:
        """Take part no longer."""
        os.close(self._gate)
        os.close(self._room)


_TURNS = pytest.StashKey[Turns]()
_FOLDER = pytest.StashKey["TemporaryDirectory[str]"]()


def _wait_for_sweeps() -> None:
    """Wait for the last command of sessions whose supervisors tests have killed."""
    until(lambda: not any(map(_is_sweep, Path("/proc").iterdir())), "the last sweep")


def _is_sweep(process: Path) -> bool:
    try:
        command = (process / "cmdline").read_bytes()
    except OSError:  # no process, or gone
        return False
    # Guards of living sessions, which tests may share, have it at the end of their own.
    return command.split(b"\0")[1:] == [b"-P", b"-m", b"play_launch.ros.fastdds", b""]


def _is_alone(item: pytest.Item) -> bool:
    return item.get_closest_marker("alone") is not None


def _order(item: pytest.Item) -> tuple[bool, int]:
    path = item.nodeid.partition("::")[0]
    ranks = (rank for rank, start in enumerate(LONGEST) if path.startswith(start))
    return _is_alone(item), next(ranks, len(LONGEST))


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers() -> int:
    """As many as keep the processors that we may use busy, where `-n auto` asks."""
    return min(WORKERS_PER_PROCESSOR * len(os.sched_getaffinity(0)), MOST_WORKERS)


@pytest.hookimpl(optionalhook=True)
def pytest_configure_node(node: Any) -> None:
    """Give a worker the folder that it shares with the others."""
    if _FOLDER not in node.config.stash:
        folder = node.config.stash[_FOLDER] = TemporaryDirectory(prefix="play-launch-tests-")
        node.config.add_cleanup(folder.cleanup)
    node.workerinput[_INPUT] = node.config.stash[_FOLDER].name


def pytest_configure(config: pytest.Config) -> None:
    """Declare the marker and keep our order of files; in a worker, take part."""
    config.addinivalue_line("markers", _MARKER)
    config.option.loadscopereorder = False
    folder = getattr(config, "workerinput", {}).get(_INPUT)
    if folder is not None:
        turns = config.stash[_TURNS] = Turns(Path(folder))
        config.add_cleanup(turns.close)


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """The longest files come first, what runs alone last and in one go: the others wait once."""
    if _TURNS in config.stash:
        items.sort(key=_order)


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(
    item: pytest.Item, nextitem: pytest.Item | None
) -> Generator[None, object, object]:
    """Wait for this test's turn, outside of what is measured as its duration."""
    turns = item.config.stash.get(_TURNS, None)
    if turns is None:
        if _is_alone(item):
            _wait_for_sweeps()
        return (yield)
    turns.enter(alone=_is_alone(item))
    if _is_alone(item):
        _wait_for_sweeps()
    try:
        return (yield)
    finally:
        if nextitem is None or not (_is_alone(item) and _is_alone(nextitem)):
            turns.leave()
