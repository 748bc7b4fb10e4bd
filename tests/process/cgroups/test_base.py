"""The group below which sessions make theirs: found, made, left as it was."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from play_launch.config.resources import NO_LIMITS, GroupPolicy
from play_launch.process.cgroups.base import GroupError
from play_launch.process.cgroups.names import SessionName
from play_launch.process.cgroups.session import SessionGroups
from tests.process.cgroups.sessions import below, lives, session_groups
from tests.support.control_groups import group_of


@pytest.mark.parametrize(
    ("path", "why"),
    [
        ("/tmp/no_group", "is not in the hierarchy of cgroup v2"),
        ("cgroup.procs/x", "cannot be made: Not a directory"),
    ],
)
def test_a_base_that_is_none(
    base: Path, path: str, why: str, caplog: pytest.LogCaptureFixture
) -> None:
    policy = GroupPolicy(enabled=True, base_path=base / path)
    groups = session_groups()
    groups.begin(policy, ())
    assert groups.folder is None
    assert groups.member("/a", NO_LIMITS) is None
    groups.end()
    (record,) = caplog.records
    assert record.message.startswith("processes run without control groups: ")
    assert why in record.message
    assert "; fix: " in record.message
    with pytest.raises(GroupError, match=why):
        session_groups().begin(GroupPolicy(enabled=True, base_path=base / path, required=True), ())


@pytest.mark.parametrize("first", [0, 1])
def test_the_last_of_two_sessions_removes_a_base_that_one_of_them_made(
    base: Path, first: int
) -> None:
    policy = GroupPolicy(enabled=True, required=True, base_path=base / "robot" / "inner")
    ours = SessionName(1, 2, 3)
    sessions = [session_groups(), SessionGroups(ours, lambda *_: True)]
    for each in sessions:
        each.begin(policy, ())
    sessions.pop(first).end()
    (left,) = sessions
    made = left.member("/a", NO_LIMITS)
    assert made is not None
    assert made[0].path.is_dir()
    left.end()
    assert below(base) == []


def test_what_a_killed_supervisor_did_to_the_base_is_undone_and_no_more(base: Path) -> None:
    (base / "somebody_s").mkdir()
    path = base / "somebody_s" / "robot"
    policy = GroupPolicy(enabled=True, required=True, base_path=path)
    # By its start time it is somebody who had our pid before.
    namespace = Path("/proc/self/ns/pid").stat().st_ino
    dead = SessionName(namespace, os.getpid(), 0)
    SessionGroups(dead, lives).begin(policy, ())
    assert below(path)
    later = session_groups()
    later.begin(policy, ())
    later.end()
    assert below(base) == ["somebody_s"]
    assert below(base / "somebody_s") == []
    (base / "somebody_s").rmdir()


ORDINARY_USER = """
import logging, os, sys
from pathlib import Path
from play_launch.config.resources import GroupPolicy
from tests.process.cgroups.sessions import session_groups

logging.basicConfig(format="%(message)s")
Path(sys.argv[1], "cgroup.procs").write_text("0")
os.setgroups([]); os.setresgid(65534, 65534, 65534); os.setresuid(65534, 65534, 65534)
groups = session_groups()
groups.begin(GroupPolicy(enabled=True), {"pids"})
print(groups.folder is not None, flush=True)
sys.stdin.readline()
groups.end()
"""


@pytest.mark.skipif(os.geteuid() != 0, reason="needs root to become another user")
@pytest.mark.parametrize(
    ("marked", "started_in", "is_taken"),
    [
        (["user@65534.service"], "", False),
        (["user@65534.service", "user@65534.service/app.scope"], "", True),
        (["user@65534.service", "user@65534.service/app.scope"], "inner", True),
        ([], "", True),
    ],
    ids=["not delegated", "delegated", "below a delegated one", "systemd before 251 marks none"],
)
def test_a_scope_of_a_user_is_taken_where_systemd_delegated_it(
    base: Path, marked: list[str], started_in: str, is_taken: bool
) -> None:
    scope = base / "user@65534.service" / "app.scope"
    group = scope / started_in
    group.mkdir(parents=True)
    for each in marked:
        os.setxattr(base / each, "user.delegate", b"1")
    for each in ("", "cgroup.procs", "cgroup.subtree_control"):
        os.chown(group / each, 65534, 65534)
    enter = 'echo 0 > "$0"/cgroup.procs; echo; exec sleep 600'
    with subprocess.Popen(["sh", "-c", enter, group], stdout=subprocess.PIPE) as terminal:
        assert terminal.stdout is not None
        terminal.stdout.readline()
        with subprocess.Popen(
            [sys.executable, "-c", ORDINARY_USER, group],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        ) as supervisor:
            assert supervisor.stdout is not None
            assert supervisor.stdout.readline() == f"{is_taken}\n"
            assert group_of(terminal.pid).endswith(group.name) == (not is_taken)
            _, log = supervisor.communicate("\n", timeout=60)
        terminal.kill()
    fix = "fix: start it by systemd-run --user --scope -p Delegate=yes play-launch"
    assert (f"{group} is systemd's own, not delegated; {fix}" in log) == (not is_taken)
