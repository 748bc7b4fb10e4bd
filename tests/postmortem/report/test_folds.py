"""What a page is made of, folded from events: lanes, marks, lines, usage, rates, bring-up."""

from __future__ import annotations

from array import array
from itertools import pairwise
from math import isnan, nan

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from play_launch.config.node_key import NodeKey
from play_launch.postmortem.report import lanes, marks, usage
from play_launch.postmortem.report.gather import Gathered
from play_launch.postmortem.report.lanes import Lanes, Shown
from play_launch.postmortem.report.lines import Lines
from play_launch.postmortem.report.rates import PARTS, Rates
from play_launch.postmortem.report.rows import NO_ROW, Rows
from play_launch.postmortem.report.usage import Usage
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

KEY = NodeKey("/box", "/sensing/talker")
TALKER = str(KEY)


def node(state: NodeState, **fields: object) -> NodeStateChanged:
    return replace(NodeStateChanged(stamp_ns=1, key=KEY, state=state), **fields)


def container(state: ContainerState) -> ContainerStateChanged:
    return ContainerStateChanged(stamp_ns=1, container="/box", state=state)


def process(kind: ProcessEventKind, name: str = "/helper", **fields: object) -> ProcessEvent:
    return replace(ProcessEvent(stamp_ns=1, kind=kind, name=name), **fields)


def output(text: str, name: str = "/box") -> OutputLine:
    return OutputLine(stamp_ns=1, process=name, pid=7, stream=Stream.STDERR, text=text)


def crash(attempt: int = 1) -> ComponentEvent:
    return ComponentEvent(
        stamp_ns=1,
        kind=ComponentEventKind.CRASHED,
        container="",
        unique_id=1,
        attempt=attempt,
        full_node_name=KEY.name,
        package_name="p",
        plugin_name="c",
        backtrace=("#0 boom()", "#1 \x1b[31mspin()"),
    )


STATES = st.lists(st.tuples(st.integers(0, 2), st.integers(0, 50), st.sampled_from(Shown)))


@given(STATES)
def test_stays_cover_the_time_of_each_row_once(changes: list[tuple[int, int, Shown]]) -> None:
    found = Lanes()
    now, begins, expected = 0.0, dict[int, float](), dict[int, Shown]()
    for row, pause, shown in changes:
        now += pause
        found.change(row, now, shown)
        begins.setdefault(row, now)
        expected[row] = shown
    found.end(now + 1)
    for row, begin in begins.items():
        mine = [i for i, each in enumerate(found.rows) if each == row]
        edges = [begin, *(found.ends[i] for i in mine)]
        assert [found.begins[i] for i in mine] == edges[:-1]
        assert edges[-1] == now + 1
        states = [found.states[i] for i in mine]
        assert all(one != two for one, two in pairwise(states))
        assert states[-1] == expected[row]


def test_stays_beyond_what_a_page_holds_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lanes, "MOST", 2)
    found = Lanes()
    for at in range(5):
        found.change(0, at, Shown.LOADED if at % 2 else Shown.AWAY)
    found.end(9)
    assert (len(found.rows), found.left_out) == (2, 3)


def test_every_state_is_drawn_somehow() -> None:
    assert lanes.OF_NODE.keys() == set(NodeState)
    assert lanes.OF_CONTAINER.keys() == set(ContainerState)
    assert lanes.OF_PROCESS.keys() == set(ProcessEventKind)


def test_a_crash_is_one_mark_with_its_backtrace() -> None:
    found = Gathered()
    events: list[RunEvent] = [
        node(NodeState.LOADED, attempt=1),
        crash(),
        node(NodeState.CRASHED, attempt=1, crashes=1, reason="SIGSEGV; it is loaded again"),
        node(NodeState.GAVE_UP, attempt=1, crashes=1, reason="limit reached"),
        node(NodeState.LOADED, attempt=2, crashes=1),
    ]
    for at, event in enumerate(events):
        found.take(float(at), event)
    crashed, gave_up = found.marks.marks
    assert (crashed.what, crashed.at, crashed.row) == ("crashed", 2.0, 0)
    assert crashed.backtrace == ("#0 boom()", "#1 spin()")
    assert (gave_up.what, gave_up.backtrace) == ("gave up", ())
    assert found.lines.texts == ["crashed: SIGSEGV; it is loaded again", "gave up: limit reached"]


def test_a_failed_load_is_a_mark() -> None:
    found = Gathered()
    found.take(1.0, node(NodeState.LOAD_FAILED, reason="no such library"))
    assert [mark.what for mark in found.marks.marks] == ["failed to load"]


def test_an_end_is_a_failure_unless_it_was_wanted() -> None:
    found = Gathered()
    exited = ProcessEventKind.EXITED
    for event in (
        process(ProcessEventKind.STARTED),
        process(exited, exit_code=0, message="exited with status 0"),
        process(ProcessEventKind.STARTED),
        process(exited, exit_code=3, message="exited with status 3"),
        process(ProcessEventKind.STARTED),
        process(ProcessEventKind.STOPPING),
        process(exited, signal=15, message="killed by signal 15"),
    ):
        found.take(1.0, event)
    assert [(mark.what, mark.reason) for mark in found.marks.marks] == [
        ("died", "exited with status 3")
    ]
    assert [row.kind for row in found.rows.rows] == ["process"]


def test_the_death_of_a_container_is_a_mark_on_its_row() -> None:
    found = Gathered()
    found.take(0.0, container(ContainerState.RUNNING))
    found.take(1.0, process(ProcessEventKind.EXITED, "/box", signal=11, message="SIGSEGV"))
    found.take(1.0, container(ContainerState.BACKOFF))
    (mark,) = found.marks.marks
    assert found.rows.rows[mark.row].kind == "container"
    assert len(found.rows.rows) == 1


def test_marks_beyond_what_a_page_holds_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(marks, "MOST", 3)
    found = Gathered()
    for number in range(1, 6):
        found.take(float(number), node(NodeState.CRASHED, crashes=number))
    assert (len(found.marks.marks), found.marks.left_out) == (3, 2)


def test_lines_belong_to_the_node_whose_logger_wrote_them() -> None:
    found, rows = Lines(), Rows()
    box = rows.number(SubjectKind.CONTAINER, "/box")
    talker = rows.number(SubjectKind.NODE, TALKER)
    for text in (
        "[INFO] [1.5] [sensing.talker]: hello",
        "\x1b[33m[WARN] [1.5] [sensing.talker]: careful\x1b[0m",
        "[ERROR] [1.5] [sensing.talker.driver]: broken",
        "no head at all",
    ):
        found.output(1.0, output(text), rows)
    assert found.texts == ["hello", "careful", "[sensing.talker.driver]: broken", "no head at all"]
    assert list(found.rows) == [talker, talker, talker, box]
    assert list(found.levels) == [20, 30, 40, 30]


def test_texts_of_several_lines_are_lines() -> None:
    found = Lines()
    found.add(1.0, NO_ROW, 40, "one\ntwo\x1b[0m\n")
    assert found.texts == ["one", "two", ""]
    assert list(found.times) == [1.0] * 3


TIMED_LEVELS = st.lists(
    st.tuples(st.integers(0, 20_000), st.sampled_from([10, 20, 30, 40])), min_size=1
)


@given(TIMED_LEVELS, st.integers(1, 20), st.integers(0, 600_000))
def test_too_many_lines_leave_what_matters(
    written: list[tuple[int, int]], most: int, failed: int
) -> None:
    found = Lines(most=most)
    found.failure(failed)
    now = 0.0
    for number, (pause, level) in enumerate(written):
        now += pause
        found.add(now, NO_ROW, level, str(number))
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
    found = Lines(most=4)
    found.failure(50_000.0)
    for at, level in (
        (0, 20),
        (1_000, 30),
        (45_000, 20),
        (80_000, 20),
        (90_000, 20),
        (120_000, 20),
    ):
        found.add(float(at), NO_ROW, level, f"at {at}")
    found.prune()
    assert found.texts == ["at 1000", "at 45000", "at 120000"]


def test_samples_of_days_keep_their_spikes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(usage, "MOST", 64)
    found = Usage()
    for second in range(1000):
        spike = 98.0 if second == 777 else 5.0
        size = 1000 if second == 333 else 2000
        found.process(0, second * 1000.0, spike, size, MemoryKind.PSS)
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


def test_what_is_not_known_does_not_disturb_thinning(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(usage, "MOST", 8)
    series = usage.Series(columns=(array("d"), array("d")))
    for second in range(30):
        series.add(second, (nan, nan if second % 2 else float(second)))
    series.finish()
    assert all(isnan(value) for value in series.columns[0])
    assert max(value for value in series.columns[1] if not isnan(value)) == 28.0


def test_shared_memory_is_told_apart() -> None:
    found = Usage()
    found.process(3, 0.0, 1.0, 5, MemoryKind.SHARED)
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


def test_bring_up_names_what_everybody_waited_for() -> None:
    found = Gathered()
    slow = replace(node(NodeState.PENDING), key=NodeKey("/box", "/slow"))
    for at, event in (
        (0, node(NodeState.PENDING)),
        (0, slow),
        (5, container(ContainerState.STARTING)),
        (100, container(ContainerState.RUNNING)),
        (101, node(NodeState.REQUESTED)),
        (102, node(NodeState.LOADING)),
        (150, node(NodeState.LOADED)),
        (101, replace(slow, state=NodeState.REQUESTED)),
        (103, replace(slow, state=NodeState.LOADING)),
    ):
        found.take(float(at), event)
    assert found.bring_up.came_up() is None
    assert found.rows.rows[found.bring_up.latest()[0].row].name == "/slow"
    found.take(9000.0, replace(slow, state=NodeState.LOADED))
    found.take(9500.0, node(NodeState.CRASHED, crashes=1))
    assert found.bring_up.came_up() == 9000.0
    latest, first = found.bring_up.latest()
    assert (latest.constructing, latest.end, latest.result) == (103.0, 9000.0, "loaded")
    assert (first.starting, first.running, first.end) == (5.0, 100.0, 150.0)
