"""A control group for tests, on a machine that lets us make one."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import mkdtemp

import pytest

from play_launch.process.cgroups.group import Group, GroupError
from play_launch.process.cgroups.session_groups import own_hierarchy


@contextmanager
def control_group() -> Iterator[Path]:
    """Make a group of our own and remove it with all that is in it; skips where that cannot be."""
    try:
        own = own_hierarchy()[1]
        path = Path(mkdtemp(prefix="play-launch-test.", dir=own))
    except (GroupError, OSError) as error:
        pytest.skip(f"no control group can be made: {error}")
    group = Group(path)
    try:
        if not os.access(path / "cgroup.kill", os.W_OK):
            pytest.skip("this kernel does not kill control groups")
        with suppress(OSError):
            path.chmod(0o755)
        yield path
    finally:
        assert group.clear(60)


def group_of(pid: int) -> str:
    """Where a process is, below the root of the hierarchy."""
    lines = Path("/proc", str(pid), "cgroup").read_text().splitlines()
    return next(line[3:] for line in lines if line.startswith("0::"))
