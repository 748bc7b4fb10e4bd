"""Samples of real control groups, of which little is read at rest."""

from __future__ import annotations

import math
import os
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from play_launch.process.cgroups.group import CONTAINER, Group, SessionName
from play_launch.process.cgroups.usage import usage_of
from play_launch.process.sampling import groups as room
from play_launch.process.sampling.groups import PERIOD, GroupSampler
from play_launch.process.sampling.processes import Target
from play_launch.supervisor.events import SubjectKind
from tests.support.control_groups import control_group
from tests.support.waiting import until


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


def test_who_enters_its_group_late_is_found(session: Group) -> None:
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
