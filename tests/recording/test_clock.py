"""The system clock is set by years while a session runs: times in its recording go on."""

from __future__ import annotations

import json
from pathlib import Path
from threading import Event

import pytest
from mcap.records import Attachment, Metadata

from play_launch.cli.explain import explain
from play_launch.config.model import RecordConfig, RotateConfig
from play_launch.config.node_key import NodeKey
from play_launch.postmortem.bag_reader import BagReader
from play_launch.postmortem.recover import write_whole
from play_launch.postmortem.timeline import read_timeline
from play_launch.recording.clock import SessionClock
from play_launch.recording.limits import RecorderLimits
from play_launch.recording.session import Session, open_session
from play_launch.recording.topics import STATES
from play_launch.supervisor.events import NodeState, NodeStateChanged
from tests.recording.reading import raw_messages, records
from tests.recording.test_opening import description

SECOND = 1_000_000_000
YEAR = 365 * 24 * 3600 * SECOND


class Machine:
    """A made-up machine: its system clock can be set, the time since its boot cannot."""

    def __init__(self, wall: int = 1_000 * SECOND) -> None:
        self.since_boot = 30 * SECOND
        self.ahead = wall - self.since_boot
        self.clock = SessionClock(self.wall, lambda: self.since_boot)

    def wall(self) -> int:
        return self.since_boot + self.ahead


def publish(session: Session, machine: Machine, state: NodeState) -> None:
    key = NodeKey("/c", "/n")
    event = NodeStateChanged(stamp_ns=machine.wall(), key=key, state=state, reason="SIGSEGV")
    written = Event()
    session.recorder.publish(event)
    session.recorder.after_these(written.set)
    assert written.wait(60)


@pytest.mark.parametrize("steps", [(2,), (-1,), (2, -2), (3, -5, 50)], ids=str)
def test_log_times_go_on_when_the_clock_is_set(
    tmp_path: Path,
    steps: tuple[int, ...],
    caplog: pytest.LogCaptureFixture,
    capsys: pytest.CaptureFixture[str],
) -> None:
    machine = Machine(wall=10 * YEAR)
    session = open_session(
        description(),
        log_folder=tmp_path,
        record=RecordConfig(rotate=RotateConfig(size=1)),  # each file is read alone, too
        limits=RecorderLimits(batch=0, flush=0),
        clock=machine.clock,
    )
    begun = machine.wall()
    publish(session, machine, NodeState.LOADED)
    for step in steps:
        machine.since_boot += 10 * SECOND
        machine.ahead += step * YEAR
        publish(session, machine, NodeState.CRASHED)
        publish(session, machine, NodeState.LOADED)
    folder = session.folder
    assert session.recorder.close().error == ""
    assert [
        f"{step * YEAR / SECOND:+.3f} s" in each.getMessage()
        for step, each in zip(steps, caplog.records, strict=True)
    ] == [True] * len(steps)

    expected = [begun + 10 * SECOND * number for number in range(len(steps) + 1)]
    reader = BagReader(folder)
    times = [each.log_time for each in reader.messages({STATES.name})]
    assert times == sorted([*expected, *expected[1:]])
    assert reader.ahead_ns == sum(steps) * YEAR
    timeline = read_timeline(folder)
    assert timeline.session.started_ns == begun
    crashes = [time for failure in timeline.failures for time in failure.times]
    assert sorted(crashes) == expected[1:], "stamps are by the system clock"
    last = sorted(folder.glob("*.mcap"))[-2]
    assert BagReader(last).damages == []
    write_whole(last, tmp_path / "whole.mcap")
    copied = [each.log_time for each in raw_messages(tmp_path / "whole.mcap", STATES.name)]
    assert copied == [each.log_time for each in raw_messages(last, STATES.name)]
    explain(folder, as_json=True)
    output, errors = capsys.readouterr()
    assert ("the clock was set" in errors) == (sum(steps) != 0)
    assert json.loads(output)["findings"][0]["times_ns"]


def test_a_session_on_an_undisturbed_machine_has_no_jumps(tmp_path: Path) -> None:
    session = open_session(description(), log_folder=tmp_path)
    publish(session, Machine(), NodeState.LOADED)
    path = session.recorder.close().path
    names = [each.name for each in records(path) if isinstance(each, Metadata)]
    assert names == ["play_launch.session"]
    stamps = {each.log_time for each in records(path) if isinstance(each, Attachment)}
    (state,) = raw_messages(path, STATES.name)
    assert 0 <= state.log_time - max(stamps) < 60 * SECOND


def test_slewing_is_no_jump() -> None:
    machine = Machine()
    for _ in range(100):
        machine.since_boot += SECOND
        machine.ahead += 500_000
        assert machine.clock.jump_ns() == 0
    machine.ahead += SECOND
    assert machine.clock.jump_ns() == SECOND + 100 * 500_000
    assert machine.clock.jump_ns() == 0


def test_a_pause_between_the_two_clocks_moves_no_time() -> None:
    """As on a busy machine, where another process runs between two readings."""
    now = iter(range(0, 1_000_000, 100))
    pauses = iter([5_000_000, 0, 7_000_000])
    paused = 0

    def wall() -> int:
        nonlocal paused
        seen = next(now) + paused
        paused += next(pauses, 0)
        return seen + 50 * SECOND

    def steady() -> int:
        return next(now) + paused

    assert abs(SessionClock(wall, steady).offset_ns - 50 * SECOND) < 1_000
