"""Groups of the real hierarchy: found, made, entered, measured, killed, swept and removed."""

from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from play_launch.config.resources import NO_LIMITS, CpuMax, GroupLimits, GroupPolicy
from play_launch.process.cgroups.group import CONTAINER, SUPERVISOR, Group, GroupError, SessionName
from play_launch.process.cgroups.session_groups import SessionGroups
from play_launch.process.cgroups.usage import usage_of
from play_launch.process.identity import ProcessIdentity, read_stat
from play_launch.process.sampling import groups as room
from play_launch.process.sampling.groups import PERIOD, GroupSampler
from play_launch.process.sampling.processes import Target
from play_launch.supervisor.events import SubjectKind
from tests.support.control_groups import control_group, group_of
from tests.support.waiting import until

UNPRIVILEGED = 65534
TRIALS = 30


@pytest.fixture
def base() -> Iterator[Path]:
    with control_group() as path:
        yield path


def begun(base: Path, **policy: bool) -> SessionGroups:
    """Groups of a session whose supervisor is this process."""
    groups = SessionGroups()
    groups.begin(GroupPolicy(enabled=True, base_path=base, **policy), ())
    assert groups.folder is not None
    return groups


def below(base: Path) -> list[str]:
    return sorted(each.name for each in base.iterdir() if each.is_dir())


def born(entry: str, *command: str) -> subprocess.Popen[str]:
    """Start a program as the guard does: it enters its group before it is executed."""
    script = 'echo 0 > "$0"/cgroup.procs && exec "$@"'
    return subprocess.Popen(
        ["sh", "-c", script, entry.partition(" ")[2], *command],
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def test_a_process_outside_of_its_group_is_reported_once(
    base: Path, caplog: pytest.LogCaptureFixture
) -> None:
    groups = begun(base)
    made = groups.member("/a", NO_LIMITS)
    assert made is not None
    with born(made[1], "sleep", "600") as process:
        until_in(made[0], process)
        groups.check("/a", process.pid)
        # Also where the base is the top of the hierarchy, whose name is in no path.
        assert Group(Path("/top", *made[0].path.parts[-2:-1])).holds(process.pid)
        assert not Group(Path("/top", *made[0].path.parts[-2:-1], "b")).holds(process.pid)
        groups.check("/other", os.getpid())
        groups.check("/a", 0)
        assert not caplog.records
        groups.check("/a", os.getpid())
        groups.check("/a", os.getpid())
        groups.end()
    (record,) = caplog.records
    assert record.message.startswith("/a is not in its control group")
    assert "; fix: " in record.message


def until_in(group: Group, process: subprocess.Popen[str]) -> None:
    """Wait until a process that is about to enter a group is in there."""
    while process.pid not in group.residents():
        assert process.poll() is None
        os.sched_yield()


def test_limits_that_the_kernel_has_not_are_reported_once(
    base: Path, caplog: pytest.LogCaptureFixture
) -> None:
    there = Group(base).path.joinpath("cgroup.controllers").read_text().split()
    if {"cpu", "memory"} & set(there):
        pytest.skip("this machine has the controllers; the guest tests what they do")
    limits = GroupLimits(cpu_max=CpuMax(50_000), memory_max=1e6)
    groups = begun(base)
    for name in ("/a", "/b"):
        made = groups.member(name, limits)
        assert made is not None
        with born(made[1], "true") as process:
            assert process.wait() == 0
    groups.end()
    said = sorted(record.message for record in caplog.records)
    assert len(said) == 2
    assert said[0].startswith("limits of cpu cannot hold: the controller is not available in")
    assert said[1].startswith("limits of memory cannot hold: the controller is not available")
    assert all("; fix: " in text for text in said)
    with pytest.raises(GroupError, match="limits of cpu cannot hold"):
        begun(base, required=True).member("/a", limits)


@pytest.mark.parametrize("moment", ["in its group", "before"])
def test_killed_supervisors_are_swept(base: Path, moment: str) -> None:
    for _ in range(TRIALS // 2):
        read_end, write_end = os.pipe()
        supervisor = os.fork()
        if supervisor == 0:
            with forked():
                groups = begun(base)
                made = groups.member("/driver", NO_LIMITS)
                groups.member("/box", NO_LIMITS, has_nodes=True)
                groups.node("/box", "/a", 1, NO_LIMITS)
                assert made is not None
                process = born(made[1], "sleep", "600")
                if moment == "in its group":
                    until_in(made[0], process)
                os.write(write_end, b"%d" % process.pid)
                signal.pause()
        os.close(write_end)
        pid = int(os.read(read_end, 20))
        os.close(read_end)
        start_time = read_stat(pid).start_time
        os.kill(supervisor, signal.SIGKILL)
        os.waitpid(supervisor, 0)
        if moment == "before":  # it may be on its way into the group, as when a guard ends it
            os.kill(pid, signal.SIGKILL)
        assert len(below(base)) == 1
        groups = begun(base)
        assert len(below(base)) == 1, "the dead one is swept, ours is there"
        groups.end()
        assert not below(base)
        if moment == "in its group":
            assert not ProcessIdentity(pid, start_time).is_alive()


def test_a_supervisor_may_be_killed_at_any_instant(base: Path) -> None:
    """Of what it does with groups: whatever it has left, the next one removes it."""
    for trial in range(TRIALS):
        read_end, write_end = os.pipe()
        supervisor = os.fork()
        if supervisor == 0:
            with forked():
                os.write(write_end, b".")
                while True:
                    groups = begun(base)
                    groups.member("/driver", NO_LIMITS)
                    groups.member("/box", NO_LIMITS, has_nodes=True)
                    groups.node("/box", "/a", 1, NO_LIMITS)
                    groups.end()
        os.close(write_end)
        os.read(read_end, 1)
        os.close(read_end)
        time.sleep(trial * 1e-4)  # it needs some milliseconds for a round
        os.kill(supervisor, signal.SIGKILL)
        os.waitpid(supervisor, 0)
        groups = begun(base)
        assert len(below(base)) == 1
        groups.end()
        assert not below(base)


@contextmanager
def forked() -> Iterator[None]:
    """End a forked process with what is done in it, without the test's own end."""
    status = 1
    try:
        yield
        status = 0
    except BaseException:  # noqa: BLE001 - nothing may get out
        traceback.print_exc(file=sys.__stderr__)
    finally:
        os._exit(status)


def in_a_fork(work: Callable[[], None]) -> None:
    """Do something in a process of its own, which may lose its rights."""
    pid = os.fork()
    if pid == 0:
        with forked():
            work()
    assert os.waitpid(pid, 0)[1] == 0


@pytest.mark.skipif(os.geteuid() != 0, reason="only root becomes another user")
def test_an_ordinary_user_in_a_delegated_group(base: Path) -> None:
    """As in a scope that systemd made with Delegate=yes."""
    scope = Group(base / "user.scope")
    scope.make()
    for path in (scope.path, *(scope.path / f"cgroup.{each}" for each in ("procs", "threads"))):
        os.chown(path, UNPRIVILEGED, UNPRIVILEGED)
    os.chown(scope.path / "cgroup.subtree_control", UNPRIVILEGED, UNPRIVILEGED)

    def inside() -> None:
        scope.move_here([0])
        os.setresuid(UNPRIVILEGED, UNPRIVILEGED, UNPRIVILEGED)
        groups = SessionGroups()
        groups.begin(GroupPolicy(enabled=True, required=True), ())
        made = groups.member("/driver", NO_LIMITS)
        assert made is not None
        with born(made[1], "sleep", "600") as process:
            until_in(made[0], process)
            groups.end()
            assert process.wait() == -signal.SIGKILL
        assert below(scope.path) == []

    def outside() -> None:
        os.setresuid(UNPRIVILEGED, UNPRIVILEGED, UNPRIVILEGED)
        groups = SessionGroups()
        with pytest.raises(GroupError, match=r"not delegated to play-launch; fix: systemd-run"):
            groups.begin(GroupPolicy(enabled=True, required=True), ())
        with pytest.raises(GroupError, match="cannot be made: Permission denied"):
            groups.begin(GroupPolicy(enabled=True, base_path=base / "other", required=True), ())

    in_a_fork(inside)
    in_a_fork(outside)
    assert below(base) == ["user.scope"]


ORDINARY_USER = """
import logging, os, sys
from pathlib import Path
from play_launch.config.resources import GroupPolicy
from play_launch.process.cgroups.session_groups import SessionGroups

logging.basicConfig(format="%(message)s")
Path(sys.argv[1], "cgroup.procs").write_text("0")
os.setgroups([]); os.setresgid(65534, 65534, 65534); os.setresuid(65534, 65534, 65534)
groups = SessionGroups()
groups.begin(GroupPolicy(enabled=True), {"pids"})
print(groups.folder is not None, flush=True)
sys.stdin.readline()
groups.end()
"""


@pytest.mark.skipif(os.geteuid() != 0, reason="only root becomes another user")
@pytest.mark.parametrize(
    ("marked", "started_in", "is_used"),
    [
        (["user@65534.service"], "", False),
        (["user@65534.service", "user@65534.service/app.scope"], "", True),
        (["user@65534.service", "user@65534.service/app.scope"], "inner", True),
        ([], "", True),
    ],
    ids=["not delegated", "delegated", "below a delegated one", "systemd before 251 marks none"],
)
def test_processes_of_a_delegated_scope_move_to_a_leaf(
    base: Path, marked: list[str], started_in: str, is_used: bool
) -> None:
    scope = base / "user@65534.service" / "app.scope"
    group = scope / started_in
    group.mkdir(parents=True)
    for each in marked:
        os.setxattr(base / each, "user.delegate", b"1")
    for each in ("", "cgroup.procs", "cgroup.subtree_control"):
        os.chown(group / each, UNPRIVILEGED, UNPRIVILEGED)
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
            assert supervisor.stdout.readline() == f"{is_used}\n"
            leaf = f"{group.name}/{SUPERVISOR}" if is_used else group.name
            assert group_of(terminal.pid).endswith(leaf)
            _, log = supervisor.communicate("\n", timeout=60)
        terminal.kill()
    fix = "is not delegated to play-launch; fix: systemd-run --user --scope -p Delegate=yes"
    assert (f"without control groups: the control group {group} {fix}" in log) == (not is_used)


def test_a_base_that_cannot_be_used_is_reported_once(
    base: Path, caplog: pytest.LogCaptureFixture
) -> None:
    for path, why in (
        ("/tmp/no_group", "is not in the hierarchy of cgroup v2"),
        ("cgroup.procs/x", "cannot be made: Not a directory"),
    ):
        caplog.clear()
        groups = SessionGroups()
        groups.begin(GroupPolicy(enabled=True, base_path=base / path), ())
        assert groups.member("/a", NO_LIMITS) is None
        groups.end()
        (record,) = caplog.records
        assert record.message.startswith("processes run without control groups: ")
        assert why in record.message
        assert "; fix: " in record.message
        required = GroupPolicy(enabled=True, base_path=base / path, required=True)
        with pytest.raises(GroupError, match=why):
            SessionGroups().begin(required, ())


@pytest.fixture
def session() -> Iterator[Group]:
    with control_group() as base:
        group = Group(base / str(SessionName(1, 2, 3)))
        group.make()
        yield group


@contextmanager
def asleep() -> Iterator[int]:
    with subprocess.Popen(["sleep", "600"]) as process:
        try:
            yield process.pid
        finally:
            process.kill()


def inside(folder: Path, pid: int) -> Group:
    group = Group(folder)
    group.make()
    group.move_here([pid])
    return group


def target(pid: int, key: str = "/a") -> Target:
    kind = SubjectKind.NODE if ":" in key else SubjectKind.CONTAINER
    return Target(kind, key, pid, 0)


class Clock:
    now = 100.0

    def __call__(self) -> float:
        return self.now


def test_a_sample_has_the_numbers_of_the_kernel(session: Group) -> None:
    with asleep() as pid:
        group = inside(session.path / "a", pid)
        (sample,), news = GroupSampler().sample([target(pid)], 7)
        usage = usage_of(group)
    assert not news
    assert (sample.kind, sample.key, sample.stamp_ns) == (SubjectKind.CONTAINER, "/a", 7)
    assert sample.group == group.path.stat().st_ino
    assert usage.cpu_seconds is not None
    assert 0 <= sample.cpu_seconds <= usage.cpu_seconds
    if usage.memory_bytes is None:
        assert sample.memory_bytes == sample.oom_kills == 0
    if usage.cpu_pressure is None:
        assert math.isnan(sample.cpu_pressure)


def test_at_rest_a_group_is_looked_at_now_and_then(session: Group) -> None:
    clock = Clock()
    sampler = GroupSampler(clock)
    with asleep() as pid:
        inside(session.path / "a", pid)
        taken = 0
        for _ in range(21):
            taken += len(sampler.sample([target(pid)], 1)[0])
            clock.now += PERIOD / 10
        assert taken == 3
        # It is the same process, and the same group, though it may be known no more.
        assert len(GroupSampler(clock).sample([target(pid)], 1)[0]) == 1


def test_without_groups_nothing_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    looks: list[int] = []

    def group_of(pid: int) -> None:
        looks.append(pid)

    monkeypatch.setattr(room, "group_of", group_of)
    sampler = GroupSampler()
    for _ in range(20):
        assert sampler.sample([target(os.getpid())], 1) == ([], [])
    assert len(looks) == 3


def test_a_process_that_enters_its_group_late_is_found(session: Group) -> None:
    clock = Clock()
    sampler = GroupSampler(clock)
    with asleep() as pid:
        assert sampler.sample([target(pid)], 1) == ([], [])
        inside(session.path / "a", pid)
        assert len(sampler.sample([target(pid)], 2)[0]) == 1


def test_a_node_in_the_group_of_its_container_has_none_of_its_own(session: Group) -> None:
    box = Group(session.path / "box")
    box.make()
    with asleep() as container, asleep() as node, asleep() as stray:
        inside(box.path / CONTAINER, container)
        inside(box.path / "n.1", node)
        Group(box.path / CONTAINER).move_here([stray])
        of_all = [target(container, "/box"), target(node, "/box:/n"), target(stray, "/box:/m")]
        samples, _ = GroupSampler().sample(of_all, 1)
    assert [each.key for each in samples] == ["/box", "/box:/n"]
    assert samples[0].group == box.number


def test_a_group_that_is_removed_is_left_out(session: Group) -> None:
    clock = Clock()
    sampler = GroupSampler(clock)
    with asleep() as pid:
        group = inside(session.path / "a", pid)
        assert sampler.sample([target(pid)], 1)[0]
        assert group.kill()
        until(group.remove, "its removal")
        clock.now += PERIOD
        assert sampler.sample([target(pid)], 2) == ([], [])
