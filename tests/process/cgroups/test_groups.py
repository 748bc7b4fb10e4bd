"""Groups of the real hierarchy: made, entered, killed, swept and removed."""

from __future__ import annotations

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
from play_launch.process.cgroups.base import GroupError
from play_launch.process.cgroups.group import Group
from play_launch.process.cgroups.names import SUPERVISOR
from play_launch.process.cgroups.usage import group_of as group_of_pid
from play_launch.process.cgroups.usage import usage_of
from play_launch.process.identity import ProcessIdentity, read_stat
from tests.process.cgroups.sessions import begun, below, session_groups
from tests.support.control_groups import group_of
from tests.support.waiting import until

NOBODY = 65534
TRIALS = 50


def born(entry: str, *command: str) -> subprocess.Popen[str]:
    """Start a program as the guard does: it enters its group before it is executed."""
    script = 'echo 0 > "$0"/cgroup.procs && exec "$@"'
    return subprocess.Popen(
        ["sh", "-c", script, entry.partition(" ")[2], *command],
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def test_a_session_from_begin_to_end(base: Path) -> None:
    groups = begun(base)
    made = groups.member("/arm/driver", NO_LIMITS)
    assert made is not None
    group, entry = made
    with born(entry, "sh", "-c", "setsid sleep 600 & echo; wait") as process:
        assert process.stdout is not None
        process.stdout.readline()
        assert group_of(process.pid).endswith("/arm:driver")
        assert group.holds(process.pid)
        assert not group.holds(os.getpid())
        assert process.pid in group.processes()
        assert len(group.processes()) == 2
        assert not group.remove()
        assert group.kill()
        assert group.wait_empty(60)
        assert process.wait() == -signal.SIGKILL
    assert group.remove()
    groups.end()
    assert not below(base)


def test_who_is_not_in_its_group_is_reported_once(
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
        groups.check("/nobody", os.getpid())
        groups.check("/a", 0)
        assert not caplog.records
        groups.check("/a", os.getpid())
        groups.check("/a", os.getpid())
        groups.end()
    (record,) = caplog.records
    assert record.message.startswith("/a is not in its control group")
    assert "; fix: " in record.message


def test_an_isolated_container_and_its_nodes_are_in_leaves(base: Path) -> None:
    groups = begun(base)
    made = groups.member("/box", NO_LIMITS, has_nodes=True)
    assert made is not None
    box, entry = made
    first = groups.node("/box", "/a", 1, NO_LIMITS)
    again = groups.node("/box", "/a", 2, NO_LIMITS)
    assert first
    assert again
    with born(entry, "sleep", "600") as container, born(first, "sleep", "600") as node:
        container_group, node_group = Group(box.path / "container"), Group(box.path / "a.1")
        assert below(box.path) == ["a.1", "a.2", "container"]
        until_in(container_group, container)
        until_in(node_group, node)
        # What a node leaves is killed when its process has ended, and nothing else is.
        assert groups.leave("/box", "/a", 1) == ""
        assert node.wait() == -signal.SIGKILL
        assert node_group.wait_empty(60)
        assert container.poll() is None
        assert sorted(box.processes()) == [container.pid]
        groups.end()
        assert container.wait() == -signal.SIGKILL
    assert not below(base)


def test_who_was_frozen_by_somebody_is_ended(base: Path) -> None:
    groups = begun(base)
    made = groups.member("/a", NO_LIMITS)
    assert made is not None
    with born(made[1], "sleep", "600") as process:
        until_in(made[0], process)
        (made[0].path / "cgroup.freeze").write_text("1")
        until(lambda: "frozen 1" in made[0].text("cgroup.events"), "its freezing")
        groups.end()
        assert process.wait() == -signal.SIGKILL
    assert not below(base)


def test_nodes_in_the_process_of_their_container_have_no_groups(base: Path) -> None:
    groups = begun(base)
    groups.member("/box", NO_LIMITS)
    assert groups.node("/box", "/n", 1, NO_LIMITS) is None
    assert groups.node("/elsewhere", "/n", 2, NO_LIMITS) is None
    groups.end()


def test_groups_that_somebody_removed_are_made_anew(
    base: Path, caplog: pytest.LogCaptureFixture
) -> None:
    groups = begun(base / "ours")
    assert groups.folder is not None
    groups.member("/box", NO_LIMITS, has_nodes=True)
    for gone in (groups.folder, base / "ours"):
        caplog.clear()
        assert Group(gone).remove()
        made = groups.member("/a", NO_LIMITS)
        assert made is not None
        with born(made[1], "true") as process:
            assert process.wait() == 0
        (record,) = caplog.records
        assert record.message.endswith(" was removed; it is made again")
        assert Group(groups.folder).remove()
        entry = groups.node("/box", "/n", 1, NO_LIMITS)
        assert entry is not None
        with born(entry, "true") as process:
            assert process.wait() == 0
    groups.end()
    assert not below(base)


def until_in(group: Group, process: subprocess.Popen[str]) -> None:
    """Wait until a process that is about to enter a group is in there."""
    while process.pid not in group.residents():
        assert process.poll() is None
        os.sched_yield()


def test_usage_is_that_of_the_group(base: Path) -> None:
    groups = begun(base)
    made = groups.member("/box", NO_LIMITS, has_nodes=True)
    node = groups.node("/box", "/hog", 1, NO_LIMITS)
    assert made is not None
    assert node
    box, entry = made
    assert group_of_pid(os.getpid()) is None
    spin = 'while :; do case $((i += 1)) in *00000) echo "$i";; esac; done'
    with born(entry, "sleep", "600") as container, born(node, "sh", "-c", spin) as hog:
        assert hog.stdout is not None
        hog.stdout.readline()
        until_in(Group(box.path / "container"), container)
        found = [group_of_pid(each.pid) for each in (container, hog)]
        # That of a container is the one that has its nodes, too.
        assert [each and each.path for each in found] == [box.path, box.path / "hog.1"]
        hog.kill()
        hog.wait()
        left: list[Group] = []
        groups.leave("/box", "/hog", 1, left.append)
        assert [each.path.name for each in left] == ["hog.1"]
        used = usage_of(box)
        assert used.cpu_seconds is not None
        assert used.cpu_seconds > 0
        groups.end()


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
    assert said[0].startswith("cpu_max and cpu_weight cannot hold: the controller cpu is not")
    assert said[1].startswith("memory_high and memory_max cannot hold: the controller memory")
    assert all("; fix: " in text for text in said)
    with pytest.raises(GroupError, match="cpu_max and cpu_weight cannot hold"):
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
        os.chown(path, NOBODY, NOBODY)
    os.chown(scope.path / "cgroup.subtree_control", NOBODY, NOBODY)

    def inside() -> None:
        scope.move_here([0])
        os.setresuid(NOBODY, NOBODY, NOBODY)
        groups = session_groups()
        groups.begin(GroupPolicy(enabled=True, required=True), ())
        made = groups.member("/driver", NO_LIMITS)
        assert made is not None
        with born(made[1], "sleep", "600") as process:
            until_in(made[0], process)
            groups.end()
            assert process.wait() == -signal.SIGKILL
        assert below(scope.path) == []

    def outside() -> None:
        os.setresuid(NOBODY, NOBODY, NOBODY)
        groups = session_groups()
        with pytest.raises(GroupError, match=r"not delegated to this user; fix: .* --user --scope"):
            groups.begin(GroupPolicy(enabled=True, required=True), ())
        with pytest.raises(GroupError, match="the nearest group above them and play-launch"):
            groups.begin(GroupPolicy(enabled=True, base_path=scope.path, required=True), ())
        with pytest.raises(GroupError, match="cannot be made: Permission denied"):
            groups.begin(GroupPolicy(enabled=True, base_path=base / "other", required=True), ())

    in_a_fork(inside)
    in_a_fork(outside)
    assert below(base) == ["user.scope"]


@pytest.mark.skipif(os.geteuid() != 0, reason="takes the right to move processes")
def test_who_is_in_the_base_makes_room_for_controllers(base: Path) -> None:
    """With a controller of memory below it, a group must not have processes of its own."""
    there = (base / "cgroup.controllers").read_text().split()
    parent = Group(base.parent)
    if not (base.parent / "cgroup.controllers").read_text().split():
        pytest.skip("no controller is there")
    controller = next(iter((base.parent / "cgroup.controllers").read_text().split()))
    before = parent.enabled
    if not there and list(parent.enable([controller], top=parent.path)):
        pytest.skip(f"{controller} cannot be enabled")
    scope = Group(base / "a.scope")
    scope.make()
    if controller not in Group(base).enabled:
        assert not list(Group(base).enable([controller], top=base))

    def supervise() -> None:
        scope.move_here([0])
        neighbour = subprocess.Popen(["sleep", "600"])
        groups = session_groups()
        groups.begin(GroupPolicy(enabled=True, required=True), [controller])
        assert group_of(os.getpid()).endswith(f"/a.scope/{SUPERVISOR}")
        assert group_of(neighbour.pid) == group_of(os.getpid())
        assert controller in scope.enabled
        # A second session in the same scope finds the same base.
        made = groups.member("/driver", NO_LIMITS)
        assert made is not None
        with born(made[1], "sleep", "600") as process:
            until_in(made[0], process)
            groups.end()
            process.wait()
        # Everything is as it was.
        assert below(scope.path) == []
        assert group_of(os.getpid()).endswith("/a.scope")
        neighbour.kill()
        neighbour.wait()

    try:
        in_a_fork(supervise)
    finally:
        scope.remove()
        Group(base).disable([controller])
        parent.disable({controller} - before)
