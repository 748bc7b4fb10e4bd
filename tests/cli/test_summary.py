from __future__ import annotations

import json
from pathlib import Path

from msgspec.structs import replace

from play_launch.cli.output import size
from play_launch.cli.run import GroupTotal
from play_launch.cli.show.summary import Summary
from play_launch.config.node_key import NodeKey
from play_launch.recording.limits import RecordingSummary
from play_launch.supervisor.events import (
    ContainerState,
    NodeState,
    ProcessEventKind,
    SubjectKind,
    WantChanged,
)
from tests.cli.scenes import START, container, folded_after, node, process, view

LONG = Path("/" + "very/" * 40) / "session.mcap"
RECORDING = RecordingSummary(path=LONG, messages=1234, dropped=0, bytes=56_000)

SYSTEM = view(
    container("/good"),
    node("/good", 0, NodeState.LOADED),
    node("/good", 1, NodeState.LOADED),
    container("/bad"),
    process("/bad", ProcessEventKind.RESTARTING, restarts=2),
    node("/bad", 0, NodeState.LOAD_FAILED, reason="no such class demo::Gone"),
    node("/bad", 1, NodeState.LOADING),
    container("/gone", ContainerState.GAVE_UP, reason="5 restarts within 60 s"),
    process("/listener", ProcessEventKind.EXITED, exit_code=3, restarts=1),
)


def printed(recording: RecordingSummary = RECORDING) -> str:
    return Summary(SYSTEM, SYSTEM, recording).text(colour=False) + "\n"


def test_the_summary_says_what_was_up_what_failed_and_where_the_recording_is() -> None:
    text = printed()
    rows = {line.split()[0]: line.split() for line in text.splitlines() if line.split()}
    assert rows["/good"] == ["/good", "2", "2", "0", "0"]
    assert rows["/bad"][:5] == ["/bad", "2", "0", "1", "2"]
    assert "waiting on /bad/n1" in text
    assert "gave up: 5 restarts within 60 s" in text
    assert rows["3"][:6] == ["3", "containers", "4", "2", "1", "2"]
    assert rows["/listener"] == ["/listener", "1", "exited", "with", "status", "3"]
    assert "/bad/n0 (/bad): load failed: no such class demo::Gone" in text
    assert f"Recording: {LONG} (1,234 messages, 56 kB)\n" in text
    assert "\x1b" not in text


RAN = view(
    container("/fine"),
    process("/fine", ProcessEventKind.READY),
    node("/fine", 0, NodeState.LOADED),
    container("/deaf"),
    process("/deaf", ProcessEventKind.READY),
    process("/sleeper", ProcessEventKind.STARTED),
    process("/python", ProcessEventKind.STARTED),
    process("/shell", ProcessEventKind.STOPPING),
    process("/undead", ProcessEventKind.STARTED),
    process("/over", ProcessEventKind.EXITED, exit_code=3),
    process("/again", ProcessEventKind.EXITED, exit_code=4),
    process("/again", ProcessEventKind.RESTARTING, message="starts again in 8.00 s"),
    process("/late", ProcessEventKind.WAITING, message="waits for /fine to be loaded"),
    process("/dismissed", ProcessEventKind.EXITED, signal=2),
    WantChanged(stamp_ns=START, unit="/dismissed", is_wanted=False),
)
AFTER = folded_after(
    RAN,
    process("/fine", ProcessEventKind.EXITED),
    process("/deaf", ProcessEventKind.EXITED, signal=9),
    process("/sleeper", ProcessEventKind.EXITED, signal=2),
    process("/python", ProcessEventKind.EXITED, exit_code=1),
    process("/shell", ProcessEventKind.EXITED, exit_code=143),
    process("/undead", ProcessEventKind.GAVE_UP, message="does not die"),
)
ENDS = {
    "/sleeper": "stopped",
    "/python": "stopped: exited with status 1",
    "/shell": "stopped",
    "/undead": "gave up: does not die",
    "/over": "exited with status 3",
    "/again": "not restarted: exited with status 4",
    "/late": "not started: waits for /fine to be loaded",
    "/dismissed": "stopped",
}


def test_the_summary_says_that_what_ran_has_stopped_and_how_if_not_as_it_should() -> None:
    text = Summary(RAN, AFTER, RECORDING).text(colour=False)
    rows = [" ".join(line.split()) for line in text.splitlines()]
    for name, end in ENDS.items():
        assert f"{name} 0 {end}" in rows
    assert "/fine 1 1 0 0" in rows
    assert "/deaf 0 0 0 0 stopped: exited with signal 9 (SIGKILL)" in rows


def test_the_summary_for_machines_says_how_each_process_ended() -> None:
    values = json.loads(json.dumps(Summary(RAN, AFTER, RECORDING).as_object(130)))
    assert {each["name"]: each["state"] for each in values["processes"]} == ENDS
    ended = {
        each["name"]: (each["exit_code"], each["signal"])
        for each in (*values["containers"], *values["processes"])
    }
    assert ended["/fine"] == (0, None)
    assert ended["/deaf"] == (None, 9)
    assert ended["/shell"] == (143, None)
    assert ended["/undead"] == ended["/late"] == (None, None)
    assert [each["name"] for each in values["processes"] if each["failed"]] == ["/over"]


def test_crashes_and_reloads_of_each_node_are_told() -> None:
    crashed = view(
        container("/c"),
        node("/c", 0, NodeState.LOADED, pid=4711, crashes=2, reloads=2),
        node("/c", 1, NodeState.GAVE_UP, reason="too often", pid=4712, crashes=4, reloads=3),
        node("/c", 2, NodeState.LOADED, pid=4713),
    )
    text = Summary(crashed, crashed, RECORDING).text(colour=False)
    rows = [line.split() for line in text.splitlines()]
    assert ["/c/n0", "2", "2", "4711", "loaded"] in rows
    assert ["/c/n1", "4", "3", "gave", "up"] in rows
    assert "/c/n1 (/c): gave up: too often" in text
    assert "/c/n2" not in text
    values = Summary(crashed, crashed, RECORDING).as_object(1)
    assert values["containers"][0]["crashes"] == 6  # type: ignore[index]


def test_crashed_nodes_with_the_same_label_are_told_apart_by_their_containers() -> None:
    unnamed = [
        replace(node(owner, 0, NodeState.LOADED, crashes=1), key=NodeKey(owner, "/[demo::Talker]"))
        for owner in ("/c", "/d")
    ]
    crashed = view(container("/c"), container("/d"), *unnamed)
    text = Summary(crashed, crashed, RECORDING).text(colour=False)
    assert "/c:/[demo::Talker]" in text
    assert "/d:/[demo::Talker]" in text


def test_units_that_limits_held_back_are_in_the_summary() -> None:
    used = {
        (SubjectKind.CONTAINER, "/bad"): GroupTotal(cpu_seconds=9.0),
        (SubjectKind.NODE, "/bad:/bad/n0"): GroupTotal(
            cpu_seconds=4.5, throttled_periods=12, throttled_seconds=1.25
        ),
        (SubjectKind.PROCESS, "/listener"): GroupTotal(oom_kills=2, pids_max_hits=3),
    }
    summary = Summary(SYSTEM, SYSTEM, RECORDING, used)
    _, _, table = summary.text(colour=False).partition("throttled by cgroup limits")
    rows = [line.split() for line in table.splitlines()]
    assert ["/bad/n0", "4.50", "s", "1.25", "s", "0", "0"] in rows
    assert ["/listener", "0.00", "s", "2", "3"] in rows
    assert not [row for row in rows if "/bad" in row]
    values = json.loads(json.dumps(summary.as_object(0)))
    assert [(each["kind"], each["key"]) for each in values["cgroups"]] == [
        ("container", "/bad"),
        ("node", "/bad:/bad/n0"),
        ("process", "/listener"),
    ]
    assert values["cgroups"][1]["throttled_seconds"] == 1.25
    assert values["cgroups"][2]["oom_kills"] == 2


def test_sizes_are_for_people() -> None:
    counts = (0, 999, 1500, 12_345_678, 999_400_000, 999_600_000, 10**10, 5 * 10**15)
    assert [size(count) for count in counts] == [
        *("0 B", "999 B", "1.5 kB", "12.3 MB", "999 MB", "1 GB", "10 GB", "5000 TB")
    ]
