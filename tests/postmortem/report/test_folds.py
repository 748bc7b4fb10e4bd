"""What a page is made of, gathered from events: lanes, marks, lines, usage, rates, bring-up."""

from __future__ import annotations

from array import array
from itertools import pairwise
from math import isnan, nan
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from play_launch.config.node_key import NodeKey
from play_launch.postmortem import timeline
from play_launch.postmortem.report import gather as gathering
from play_launch.postmortem.report.gather import Gathered, Shown
from play_launch.postmortem.report.log_lines import Lines
from play_launch.postmortem.report.series import PARTS, Rates, Series, Usage
from play_launch.postmortem.timeline import Timeline
from play_launch.postmortem.units import NO_UNIT
from play_launch.supervisor.events import (
    ComponentEvent,
    ComponentEventKind,
    ContainerState,
    ContainerStateChanged,
    MemoryKind,
    NodeState,
    NodeStateChanged,
    OutputLine,
    ProcessEvent,
    ProcessEventKind,
    RunEvent,
    Stream,
    SubjectKind,
)
from play_launch.supervisor.outcome import Cause, Sequel
from tests.postmortem.report.recordings import BEGIN, gather, record
from tests.postmortem.scenes import Scene

KEY = NodeKey("/box", "/sensing/talker")
TALKER = str(KEY)


def node(state: NodeState, **fields: object) -> NodeStateChanged:
    return replace(NodeStateChanged(stamp_ns=1, key=KEY, state=state, cause=Cause.NONE), **fields)


def container(state: ContainerState) -> ContainerStateChanged:
    return ContainerStateChanged(stamp_ns=1, container="/box", state=state)


def process(kind: ProcessEventKind, name: str = "/helper", **fields: object) -> ProcessEvent:
    return replace(ProcessEvent(stamp_ns=1, kind=kind, name=name, cause=Cause.NONE), **fields)


def output(text: str, name: str = "/box") -> OutputLine:
    return OutputLine(stamp_ns=1, process=name, pid=7, stream=Stream.STDERR, text=text)


def crash(stamp_ns: int = 1) -> ComponentEvent:
    return ComponentEvent(
        stamp_ns=stamp_ns,
        kind=ComponentEventKind.CRASHED,
        container="",
        unique_id=1,
        attempt=1,
        full_node_name=KEY.name,
        package_name="p",
        plugin_name="c",
        backtrace=("#0 boom()", "#1 \x1b[31mspin()"),
    )


def gathered(folder: Path, *events: RunEvent | tuple[float, RunEvent]) -> Gathered:
    """What a recording of these events gives; their times are milliseconds after the start."""
    timed = [each if isinstance(each, tuple) else (n, each) for n, each in enumerate(events)]
    stamped = [replace_stamp(event, BEGIN + round(at * 1e6)) for at, event in timed]
    return gather(record(folder / "session.mcap", stamped))


def replace_stamp(event: RunEvent, stamp_ns: int) -> RunEvent:
    if isinstance(event, ComponentEvent):
        return crash(stamp_ns)
    return replace(event, stamp_ns=stamp_ns)


@given(st.lists(st.tuples(st.integers(0, 2), st.integers(0, 50), st.sampled_from(NodeState))))
def test_stays_cover_the_time_of_each_row_once(
    changes: list[tuple[int, int, NodeState]],
) -> None:
    found = Gathered(Timeline(Path("none")))
    now, begins, expected = 0.0, dict[int, float](), dict[int, Shown]()
    rows: dict[int, int] = {}
    for name, pause, state in changes:
        now += pause
        event = node(state, key=NodeKey("/box", f"/{name}"))
        found.timeline.fold(event, round(now * 1e6))
        rows[name] = found.timeline.unit(SubjectKind.NODE, str(event.key)).number
        begins.setdefault(rows[name], now)
        expected[rows[name]] = gathering._shown(state)
    found.end = now + 1
    lanes = found.lanes()
    for row, begin in begins.items():
        mine = [i for i, each in enumerate(lanes.rows) if each == row]
        edges = [begin, *(lanes.ends[i] for i in mine)]
        assert [lanes.begins[i] for i in mine] == edges[:-1]
        assert edges[-1] == now + 1
        states = [lanes.states[i] for i in mine]
        assert all(one != two for one, two in pairwise(states))
        assert states[-1] == expected[row]


def test_stays_beyond_what_a_page_holds_are_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(timeline, "MOST_CHANGES", 2)
    states = [NodeState.LOADED, NodeState.UNLOADED, NodeState.LOADED, NodeState.UNLOADED]
    found = gathered(tmp_path, *map(node, states))
    assert (len(found.lanes().rows), found.timeline.changes_left_out) == (2, 2)


@pytest.mark.parametrize("state", [*NodeState, *ContainerState, *ProcessEventKind])
def test_every_state_is_drawn(state: NodeState) -> None:
    assert gathering._shown(state) in Shown


def test_a_crash_is_one_mark_with_its_backtrace(tmp_path: Path) -> None:
    gives_up = {"cause": Cause.SIGNAL, "sequel": Sequel.GAVE_UP}
    found = gathered(
        tmp_path,
        node(NodeState.LOADED, attempt=1),
        crash(),
        node(NodeState.CRASHED, attempt=1, unique_id=1, crashes=1, reason="SIGSEGV", **gives_up),
        node(NodeState.GAVE_UP, attempt=1, crashes=1, reason="limit reached", **gives_up),
        node(NodeState.LOADED, attempt=2, crashes=1),
    )
    crashed, gave_up = found.marks()
    assert (crashed.what, crashed.at, crashed.row) == ("crashed", 2.0, 0)
    assert crashed.backtrace == ("#0 boom()", "#1 spin()")
    assert (gave_up.what, gave_up.backtrace) == ("gave up", ())
    assert found.lines.texts == ["crashed: SIGSEGV", "gave up: limit reached"]


def test_a_failed_load_is_a_mark(tmp_path: Path) -> None:
    found = gathered(tmp_path, node(NodeState.LOAD_FAILED, reason="no such library"))
    assert [mark.what for mark in found.marks()] == ["failed to load"]


def test_an_end_is_a_failure_unless_it_was_wanted(tmp_path: Path) -> None:
    exited = ProcessEventKind.EXITED
    status, sigterm = "exited with status 3", "killed by signal 15"
    found = gathered(
        tmp_path,
        process(ProcessEventKind.STARTED),
        process(exited, exit_code=0, message="exited with status 0"),
        process(ProcessEventKind.STARTED),
        process(exited, exit_code=3, message=status, cause=Cause.EXIT_STATUS),
        process(ProcessEventKind.STARTED),
        process(ProcessEventKind.STOPPING, cause=Cause.STOPPED),
        process(exited, signal=15, message=sigterm, cause=Cause.STOPPED),
    )
    assert [(mark.what, mark.reason) for mark in found.marks()] == [("died", status)]
    assert [row.kind for row in found.rows()] == ["process"]


def test_the_death_of_a_container_is_a_mark_on_its_row(tmp_path: Path) -> None:
    died = {"signal": 11, "message": "SIGSEGV", "cause": Cause.SIGNAL}
    found = gathered(
        tmp_path,
        container(ContainerState.RUNNING),
        process(ProcessEventKind.EXITED, "/box", **died),
        container(ContainerState.BACKOFF),
    )
    (mark,) = found.marks()
    assert found.rows()[mark.row].kind == "container"
    assert len(found.rows()) == 1


def test_marks_beyond_what_a_page_holds_are_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(timeline, "MOST_EVENTS", 3)
    crashes = (node(NodeState.CRASHED, crashes=number) for number in range(1, 6))
    found = gathered(tmp_path, *crashes)
    assert (len(found.marks()), found.timeline.events_left_out) == (3, 2)


def test_lines_belong_to_the_node_whose_logger_wrote_them(tmp_path: Path) -> None:
    texts = (
        "[INFO] [1.5] [sensing.talker]: hello",
        "\x1b[33m[WARN] [1.5] [sensing.talker]: careful\x1b[0m",
        "[ERROR] [1.5] [sensing.talker.driver]: broken",
        "no head at all",
    )
    states = container(ContainerState.RUNNING), node(NodeState.LOADED)
    lines = gathered(tmp_path, *states, *map(output, texts)).lines
    assert lines.texts == ["hello", "careful", "[sensing.talker.driver]: broken", "no head at all"]
    assert list(lines.rows) == [1, 1, 1, 0]
    assert list(lines.levels) == [20, 30, 40, 30]


def test_texts_of_several_lines_are_lines() -> None:
    found = lines()
    found.add(1.0, NO_UNIT, 40, "one\ntwo\x1b[0m\n")
    assert found.texts == ["one", "two", ""]
    assert list(found.times) == [1.0] * 3


def lines(most: int = 400_000) -> Lines:
    return Lines(Timeline(Path("none")), most)


TIMED_LEVELS = st.lists(
    st.tuples(st.integers(0, 20_000), st.sampled_from([10, 20, 30, 40])), min_size=1
)


@given(TIMED_LEVELS, st.integers(1, 20), st.integers(0, 600_000))
def test_too_many_lines_leave_what_matters(
    written: list[tuple[int, int]], most: int, failed: int
) -> None:
    found = lines(most)
    found.failure(failed)
    now = 0.0
    for number, (pause, level) in enumerate(written):
        now += pause
        found.add(now, NO_UNIT, level, str(number))
    found.prune()
    assert len(found.texts) <= most
    assert len(found.texts) + found.left_out == len(written)
    assert list(found.times) == sorted(found.times)
    assert [int(text) for text in found.texts] == sorted(int(text) for text in found.texts)
    if len(written) <= most:
        assert not found.left_out
    # The last line is one of what is kept.
    assert found.texts[-1] == str(len(written) - 1)


def test_lines_far_from_failures_go_first() -> None:
    found = lines(4)
    found.failure(50_000.0)
    for at, level in (
        (0, 20),
        (1_000, 30),
        (45_000, 20),
        (80_000, 20),
        (90_000, 20),
        (120_000, 20),
    ):
        found.add(float(at), NO_UNIT, level, f"at {at}")
    found.prune()
    assert found.texts == ["at 1000", "at 45000", "at 120000"]


def test_samples_of_days_keep_their_spikes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("play_launch.postmortem.report.series.MOST", 64)
    found = Usage()
    for second in range(1000):
        spike = 98.0 if second == 777 else 5.0
        size = 1000 if second == 333 else 2000
        found.process(0, MemoryKind.PSS, [second * 1000.0], [spike], [size])
    found.finish()
    (series,) = found.of_rows.values()
    cpu, memory = series.columns
    assert len(series.times) == len(cpu) == len(memory) < 64 + 64
    assert list(series.times) == sorted(series.times)
    assert (max(cpu), min(memory)) == (98.0, 1000.0)
    assert abs(series.times[cpu.index(98.0)] - 777_000) <= 64_000
    assert series.times[-1] == 999_000
    distances = [b - a for a, b in pairwise(series.times)]
    assert max(distances[:20]) == max(distances)  # early ones are no coarser than later ones


def test_every_sample_is_drawn_however_units_follow_each_other(tmp_path: Path) -> None:
    scene = Scene()
    for at in range(20):
        scene.used(at, "/a", cpu_percent=at)
    for at in range(20, 40):
        scene.used(at, "/a", cpu_percent=at)
        scene.used(at, "/b", cpu_percent=-at)
    found = gather(scene.record(tmp_path / "session.mcap"))
    names = [row.name for row in found.rows()]
    drawn = {names[row]: series for row, series in found.usage.of_rows.items()}
    assert list(drawn["/a"].columns[0]) == list(range(40))
    assert list(drawn["/a"].times) == [at * 1000 for at in range(40)]
    assert list(drawn["/b"].columns[0]) == [-at for at in range(20, 40)]


def test_what_is_not_known_does_not_disturb_thinning(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("play_launch.postmortem.report.series.MOST", 8)
    series = Series(columns=(array("d"), array("d")))
    for second in range(30):
        series.add(second, (nan, nan if second % 2 else float(second)))
    series.finish()
    assert all(isnan(value) for value in series.columns[0])
    assert max(value for value in series.columns[1] if not isnan(value)) == 28.0


def test_shared_memory_is_told_apart() -> None:
    found = Usage()
    found.process(3, MemoryKind.SHARED, [0.0], [1.0], [5])
    assert [series.is_shared for series in found.of_rows.values()] == [True]


@given(st.lists(st.tuples(st.sampled_from(["/a", "/b"]), st.integers(0, 10**9))))
def test_rates_count_every_message(messages: list[tuple[str, int]]) -> None:
    found = Rates()
    for topic, at in messages:
        found.add(topic, float(at))
    for topic in ("/a", "/b"):
        times = [at for name, at in messages if name == topic]
        counts = list(found.counts.get(topic, ()))
        assert sum(counts) == len(times)
        for part, count in enumerate(counts):
            begin, end = part * found.width, (part + 1) * found.width
            assert count == sum(begin <= at < end for at in times)
    assert all(len(counts) == PARTS for counts in found.counts.values())


def test_bring_up_has_what_the_system_waited_for(tmp_path: Path) -> None:
    slow = NodeKey("/box", "/slow")
    events: list[tuple[float, RunEvent]] = [
        (0, node(NodeState.PENDING)),
        (0, node(NodeState.PENDING, key=slow)),
        (5, container(ContainerState.STARTING)),
        (100, container(ContainerState.RUNNING)),
        (101, node(NodeState.REQUESTED)),
        (101, node(NodeState.REQUESTED, key=slow)),
        (102, node(NodeState.LOADING)),
        (103, node(NodeState.LOADING, key=slow)),
        (150, node(NodeState.LOADED)),
    ]
    found = gathered(tmp_path, *events)
    assert found.came_up() is None
    assert found.rows()[found.arrivals()[0].row].name == "/slow"
    events.append((9000, node(NodeState.LOADED, key=slow)))
    events.append((9500, node(NodeState.CRASHED, crashes=1)))
    found = gathered(tmp_path / "later", *events)
    assert found.came_up() == 9000.0
    latest, first = found.arrivals()
    assert (latest.constructing, latest.end, latest.result) == (103.0, 9000.0, "loaded")
    assert (first.starting, first.running, first.end) == (5.0, 100.0, 150.0)
