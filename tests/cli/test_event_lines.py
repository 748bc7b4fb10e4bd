from __future__ import annotations

import pytest
from msgspec.structs import replace

from play_launch.cli.show.event_lines import DisplayLine, format_lines, line_of
from play_launch.control.event_words import names_of
from play_launch.supervisor.events import (
    ContainerState,
    LogRecord,
    ManagedNodeChanged,
    ManagedState,
    NodeState,
    ProcessEventKind,
    RunEvent,
    Stream,
    SubjectKind,
    WantChanged,
    Withdrawn,
)
from tests.cli.scenes import START, container, node, output, process, view
from tests.postmortem.scenes import requested


def line(event: RunEvent, *earlier: RunEvent) -> DisplayLine | None:
    before = view(*earlier)
    return line_of(event, before, before.after(event))


def text(event: RunEvent, *earlier: RunEvent) -> str:
    found = line(event, *earlier)
    assert found is not None
    return f"{found.level} {found.source} {found.text}"


def test_output_keeps_its_words_and_its_level() -> None:
    assert text(output("hello")) == "20 /a hello"
    assert text(output("hello", Stream.STDERR)) == "30 /a hello"
    assert text(output("[ERROR] [1.0] [a]: x", Stream.STDERR)) == "40 /a [ERROR] [1.0] [a]: x"


def test_nodes_that_load_count_up() -> None:
    pending: list[RunEvent] = [
        container("/c"),
        node("/c", 0, NodeState.PENDING),
        node("/c", 1, NodeState.PENDING),
    ]
    loaded = line(node("/c", 0, NodeState.LOADED, elapsed=0.3), *pending)
    assert loaded is not None
    assert loaded.text == "/c/n0 loaded in 300 ms (1/2)"
    assert loaded.is_progress
    confirmed = line(node("/c", 0, NodeState.LOADED, reason="confirmed by status"), *pending)
    assert confirmed is not None
    assert not confirmed.is_progress


def test_a_node_with_a_process_of_its_own_is_told_with_its_pid() -> None:
    started: list[RunEvent] = [container("/c"), process("/c", ProcessEventKind.READY)]
    own = node("/c", 0, NodeState.LOADED, pid=78)
    assert text(own, *started) == "20 /c /c/n0 loaded, pid 78 (1/1)"
    again = line(node("/c", 0, NodeState.LOADED, pid=79, crashes=1, reloads=1), *started)
    assert again is not None
    assert again.text == "/c/n0 loaded again, pid 79 (1/1)"
    assert not again.is_progress


def test_a_slow_node_is_reported_when_it_is_told_again() -> None:
    loading: list[RunEvent] = [container("/c"), node("/c", 0, NodeState.LOADING)]
    assert line(loading[1], loading[0]) is None
    again = node("/c", 0, NodeState.LOADING, at=15, elapsed=15, reason="its constructor runs")
    assert text(again, *loading) == "20 /c /c/n0 is still loading after 15 s: its constructor runs"


@pytest.mark.parametrize(
    ("state", "expected"),
    [
        (NodeState.LOAD_FAILED, "40 /c /c/n0 failed to load: why"),
        (NodeState.CRASHED, "40 /c /c/n0 crashed: why"),
        (NodeState.GAVE_UP, "40 /c /c/n0 is not loaded again: why"),
        (NodeState.LOST, "30 /c /c/n0 lost: why"),
    ],
)
def test_failures_are_told_once_with_their_reason(state: NodeState, expected: str) -> None:
    event = node("/c", 0, state, reason="why")
    assert text(event, container("/c")) == expected
    assert line(event, container("/c"), event) is None


def test_processes_tell_how_they_end_and_what_happens_next() -> None:
    dead = process("/c", ProcessEventKind.EXITED, signal=11)
    assert text(dead) == "40 /c exited with signal 11 (SIGSEGV)"
    again = process("/c", ProcessEventKind.RESTARTING, restarts=2, message="again in 200 ms")
    assert text(again) == "30 /c again in 200 ms"
    gone = process("/c", ProcessEventKind.GAVE_UP, message="5 restarts within 60 s")
    assert text(gone) == "40 /c 5 restarts within 60 s"


def test_an_end_that_was_asked_for_is_no_error() -> None:
    asked: list[RunEvent] = [
        container("/c", ContainerState.STOPPING),
        process("/c", ProcessEventKind.STOPPING),
        process("/p", ProcessEventKind.STOPPING),
    ]
    for name in ("/c", "/p"):
        dead = process(name, ProcessEventKind.EXITED, signal=2)
        assert text(dead, *asked) == f"20 {name} exited with signal 2 (SIGINT)"


def test_the_log_shows_warnings_only() -> None:
    assert line(LogRecord(stamp_ns=START, level=20, name="n", message="m")) is None
    warning = LogRecord(stamp_ns=START, level=30, name="play_launch.x", message="m")
    assert text(warning) == "30 play-launch m"


def test_lines_are_laid_out_with_their_source_and_cleaned() -> None:
    lines = [
        DisplayLine(START, "/a", "one\ntwo"),
        DisplayLine(START, "/a", "\x1b[2J\x1b[31mred\x1b[0m\x07"),
        DisplayLine(START, "/a", "bad", 40),
    ]
    assert format_lines(lines, times=False, colour=False) == (
        "[/a] one\n[/a] two\n[/a] red\n[/a] bad\n"
    )
    coloured = format_lines(lines, times=False, colour=True)
    assert "\x1b[31mred\x1b[0m\x1b[0m\n" in coloured
    assert "\x1b[31mbad\x1b[0m\n" in coloured
    assert "\x1b[2J" not in coloured
    timed = format_lines([DisplayLine(START + 7_000_000, "/a", "x")], times=True, colour=False)
    assert timed.endswith(".007 [/a] x\n")


def test_an_attached_container_has_no_pid() -> None:
    assert text(process("/c", ProcessEventKind.STARTED, pid=0), container("/c")) == (
        "20 /c attaching"
    )
    assert text(process("/c", ProcessEventKind.STARTED, pid=7)) == "20 /c started, pid 7"


def test_managed_nodes_say_where_they_are_and_what_failed() -> None:
    def managed(state: ManagedState, reason: str = "") -> ManagedNodeChanged:
        return ManagedNodeChanged(
            stamp_ns=START, unit="/c:/m", node="/m", state=state, reason=reason
        )

    assert line(managed(ManagedState.ABSENT)) is None
    assert line(managed(ManagedState.ASKED)) is None
    assert text(managed(ManagedState.ACTIVE)) == "20 /m is active"
    failed = managed(ManagedState.FAILED, "its transition configure failed")
    assert text(failed) == "40 /m autostart failed: its transition configure failed"


def test_what_waits_says_for_what() -> None:
    waiting = node("/c", 0, NodeState.PENDING, reason="waits for /d to be loaded")
    assert text(waiting) == "20 /c /c/n0 waits for /d to be loaded"
    held = container("/c", ContainerState.STARTING, reason="waits for a publisher of /scan")
    assert text(held) == "20 /c starting: waits for a publisher of /scan"


def test_an_action_on_the_whole_system_has_no_names() -> None:
    asked = replace(requested(START, "apply", ()), reason="a.yaml")
    assert text(asked) == "20 play-launch apply (a.yaml): requested by user 0, pid 1"


@pytest.mark.parametrize(
    "event",
    [
        requested(START, "signal", ("/box:/talker",)),
        WantChanged(stamp_ns=START, unit="/box:/talker", is_wanted=False),
        Withdrawn(stamp_ns=START, kind=SubjectKind.NODE, key="/box:/talker"),
    ],
)
def test_what_is_about_a_node_is_found_by_its_name_and_its_container(event: RunEvent) -> None:
    assert names_of(event) == ("/talker", "/box")
