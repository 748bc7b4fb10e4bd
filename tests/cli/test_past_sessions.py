"""`play-launch info` and `inspect`, the real commands on real and on damaged recordings."""

from __future__ import annotations

import json
import re
import socket
import time
from typing import TYPE_CHECKING

import pytest

from play_launch.cli.events import since_when
from play_launch.config.node_key import NodeKey
from play_launch.supervisor.events import (
    ComponentEvent,
    ComponentEventKind,
    ContainerState,
    ContainerStateChanged,
    LogRecord,
    NodeState,
    NodeStateChanged,
    OutputLine,
    ProcessEvent,
    ProcessEventKind,
    RunEvent,
    Stream,
)
from tests.postmortem.archive.scenes import begin_session, past_session
from tests.postmortem.scenes import Scene
from tests.postmortem.test_past_session import record
from tests.support.replay import replaying, run

if TYPE_CHECKING:
    from pathlib import Path

SECOND = 1_000_000_000


def node(state: NodeState, crashes: int = 0) -> NodeStateChanged:
    return NodeStateChanged(
        stamp_ns=5,
        key=NodeKey("/box", "/talker"),
        state=state,
        reason="SIGSEGV" if state is NodeState.CRASHED else "",
        crashes=crashes,
    )


EVENTS: list[RunEvent] = [
    ContainerStateChanged(stamp_ns=5, container="/box", state=ContainerState.STARTING),
    ProcessEvent(stamp_ns=5, kind=ProcessEventKind.STARTED, name="/box", pid=4711),
    node(NodeState.LOADED),
    OutputLine(stamp_ns=5, process="/box", pid=7, stream=Stream.STDOUT, text="hello\x1b[2J"),
    ComponentEvent(
        stamp_ns=5,
        kind=ComponentEventKind.CRASHED,
        container="",
        unique_id=1,
        attempt=1,
        full_node_name="/talker",
        package_name="p",
        plugin_name="c",
        signal=11,
        backtrace=("#0 boom() (libp.so+0x1)",),
    ),
    node(NodeState.CRASHED, crashes=1),
    LogRecord(stamp_ns=5, level=30, name="x", message="odd"),
]

CRASH = ["backtrace:", "  #0 boom() (libp.so+0x1)", "/talker crashed: SIGSEGV"]


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    return record(tmp_path / "session.mcap", EVENTS)


def test_info_sums_up(bag: Path) -> None:
    result = run("info", bag)
    assert (result.returncode, result.stderr) == (0, "")
    assert "Crashes:   1 (/talker 1)" in result.stdout
    assert "1 container, 1 node, 0 processes" in result.stdout
    assert "/play_launch/states" in result.stdout
    found = json.loads(run("info", bag, "--json").stdout)
    assert found["crashes"] == {"/talker": 1}
    assert found["session"]["name"] == "x"
    counts = {topic["name"]: topic["messages"] for topic in found["topics"]}
    assert counts["/play_launch/output"] == 1
    assert counts["/play_launch/states"] == 4


def test_inspect_shows_what_happened_in_order(bag: Path) -> None:
    result = run("inspect", bag)
    assert (result.returncode, result.stderr) == (0, "")
    texts = [line.split("] ", 1)[1] for line in result.stdout.splitlines()]
    assert texts == ["started, pid 4711", "/talker loaded (1/1)", "hello", *CRASH, "odd"]


@pytest.mark.parametrize(
    ("options", "texts"),
    [
        (["--level", "error"], CRASH),
        (["--level", "warn", "--node", "/b*"], ["/talker crashed: SIGSEGV"]),
        (["--node", "/absent"], []),
        (["--until", "1ms", "--level", "warn", "--node", "/talker"], CRASH),
        (["--since", "1h"], []),
        (["--around", "1h"], []),
    ],
)  # fmt: skip
def test_inspect_filters(bag: Path, options: list[str], texts: list[str]) -> None:
    result = run("inspect", bag, *options)
    assert result.returncode == 0
    assert [line.split("] ", 1)[1] for line in result.stdout.splitlines()] == texts


@pytest.mark.parametrize(
    ("options", "texts"),
    [
        (["--around", "22:13:18"], ["dusk"]),
        (["--around", "02:13:20"], ["night"]),
        (["--since", "02:13"], ["night"]),
        (["--since", "22:00"], ["dusk", "night"]),
        (["--until", "02:13"], ["dusk"]),
        (["--since", "22:14:00", "--until", "02:13:20"], ["night"]),
    ],
)
def test_a_time_of_the_day_after_midnight_is_that_of_the_next_day(
    options: list[str], texts: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TZ", "UTC0")
    scene = Scene()
    scene.line(0.0, "dusk")
    scene.line(4.0 * 3600, "night")
    result = run("inspect", scene.record(tmp_path / "session.mcap"), *options)
    assert (result.returncode, result.stderr) == (0, "")
    assert [line.split("] ", 1)[1] for line in result.stdout.splitlines()] == texts


@pytest.mark.parametrize(
    ("now", "text", "seconds"),
    [
        ("2026-03-10 14:05:00", "14:03", 120.0),
        ("2026-03-10 00:05:00", "23:50", 900.0),
        ("2026-03-10 14:05:00", "14:05:00", 0.0),
        # An hour of that night is missing.
        ("2026-03-29 03:30:00", "01:30", 3600.0),
    ],
)
def test_logs_begin_where_the_clock_was_last(
    now: str, text: str, seconds: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TZ", "CET-1CEST,M3.5.0,M10.5.0/3")
    time.tzset()
    try:
        at = time.mktime(time.strptime(now, "%Y-%m-%d %H:%M:%S"))
        assert since_when(text, at) == (at - seconds) * 1e9
    finally:
        monkeypatch.undo()
        time.tzset()


def test_inspect_for_programs(bag: Path) -> None:
    events = [json.loads(line) for line in run("inspect", bag, "--json").stdout.splitlines()]
    kinds = ["container", "process", "node", "output", "component", "node", "log"]
    assert [event["event"] for event in events] == kinds


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--level", "loud"], "Invalid value for '--level'"),
        (["--since", "soon"], "--since soon: "),
        (["--around", "1s", "--until", "2s"], "--around cannot be combined"),
    ],
)
def test_wrong_options_are_explained(bag: Path, options: list[str], words: str) -> None:
    result = run("inspect", bag, *options)
    assert result.returncode == 2
    assert words in result.stderr
    assert result.stdout == ""


@pytest.mark.parametrize("verb", ["info", "inspect"])
def test_damage_is_located_and_the_rest_shown(bag: Path, verb: str) -> None:
    whole = bag.read_bytes()
    bag.write_bytes(whole[: len(whole) - 100])
    result = run(verb, bag)
    assert result.returncode == 5
    assert "Traceback" not in result.stderr
    assert f"warning: {bag}: " in result.stderr
    assert "/talker" in result.stdout


def test_recover_names_what_it_wrote_and_what_is_missing(bag: Path) -> None:
    result = run("recover", bag)
    assert (result.returncode, result.stderr) == (0, "")
    whole = bag.with_name("session.recovered.mcap")
    assert result.stdout == f"{whole}: 8 messages\n"
    assert run("info", whole).returncode == 0
    bag.write_bytes(bag.read_bytes()[:-6000])
    result = run("recover", bag, "--output", bag.with_name("other.mcap"))
    assert result.returncode == 5
    assert f"warning: {bag}: byte " in result.stderr
    again = run("recover", bag)
    assert again.returncode == 1
    assert "exists; name another file with --output" in again.stderr


CONFIG = """
version: 1
name: past
containers:
  - name: chat
    composable_nodes:
      - {package: play_launch_demo, plugin: "play_launch_demo::Talker", name: talker}
"""


def recorded_at(folder: Path) -> str:
    here = {"machine": "h1", "local": True, "ssh": "", "folder": str(folder), "offsets": []}
    return json.dumps([here])


def test_a_machine_that_is_gone_is_left_out_of_what_is_collected(bag: Path) -> None:
    (bag.parent / "machines.json").write_text(recorded_at(bag.parent / "gone"))
    found = run("collect", bag.parent, "--json", code=1)
    assert "h1: its recording cannot be fetched" in found.stderr
    collected = json.loads(found.stdout)
    assert collected["missing"] == ["h1"]
    run("info", collected["output"], code=0)


def test_what_is_not_finished_is_collected_as_far_as_it_goes(tmp_path: Path) -> None:
    """The coordinator was killed, and the other machine goes on."""
    coordinator, other = tmp_path / "one", tmp_path / "other"
    for folder in (coordinator, other):
        folder.mkdir()
        bag = record(folder / "session.mcap", EVENTS)
        whole = bag.read_bytes()
        bag.rename(folder / "session.mcap.active").write_bytes(whole[: len(whole) // 2])
        with socket.socket(socket.AF_UNIX) as left:
            left.bind(str(folder / "control.sock"))
    (coordinator / "machines.json").write_text(recorded_at(other))
    found = run("collect", coordinator, "--json", code=0)
    assert "h1: its recording is not finished" in found.stderr
    shown = run("inspect", json.loads(found.stdout)["output"], code=0).stdout
    assert "/talker" in shown
    before = json.loads(found.stdout)["messages"]
    longer = record(tmp_path / "longer.mcap", [*EVENTS, *EVENTS]).read_bytes()
    (other / "session.mcap.active").write_bytes(longer[: len(longer) // 2])
    assert json.loads(run("collect", coordinator, "--json").stdout)["messages"] > before


def test_the_other_machine_does_not_choose_where_its_files_come(bag: Path, tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    record(tmp_path / "other" / "session.mcap", EVENTS)
    (bag.parent / "machines.json").write_text(recorded_at(tmp_path / "other" / "x" / ".."))
    (tmp_path / "other" / "x").mkdir()
    run("collect", bag.parent, code=0)
    assert bag.exists()


def test_a_session_that_runs_is_not_collected(tmp_path: Path) -> None:
    config = tmp_path / "system.yaml"
    config.write_text("version: 1\nnodes: [{name: n, command: [sleep, '60']}]\n")
    with replaying(config, tmp_path / "logs") as replay:
        replay.until_operable()
        (replay.bag.parent / "machines.json").write_text("[]")
        refused = run("collect", replay.bag.parent.resolve(), code=2)
        assert "collect it when it has ended" in refused.stderr


def test_a_real_session_is_read_while_it_runs_and_afterwards(tmp_path: Path) -> None:
    config = tmp_path / "past.yaml"
    config.write_text(CONFIG, encoding="utf-8")
    with replaying(config, tmp_path / "logs") as session:
        session.read_until_states({"/talker": "loaded"})
        bag = session.log_dir / "latest" / "session.mcap"
        running = run("info", bag.with_name("session.mcap.active"))
        assert running.returncode == 5
        assert "not closed in order" in running.stderr
    found = json.loads(run("info", bag, "--json").stdout)
    assert (found["complete"], found["nodes"], found["session"]["name"]) == (True, 1, "past")
    assert re.search(r"/talker loaded .*\(1/1\)", run("inspect", bag, "--node", "/talker").stdout)


def test_without_a_name_it_is_the_latest_session(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PLAY_LAUNCH_LOG_DIR", str(tmp_path))
    for verb in ("info", "explain", "report"):
        assert f"no session was recorded in {tmp_path}" in run(verb, code=2).stderr
    config = tmp_path / "first.yaml"
    for name in ("first", "second"):
        sleep = "nodes: [{command: [sleep, '9'], name: sleep}]"
        config.write_text(f"{{version: 1, name: {name}, duration: 200 ms, {sleep}}}")
        run("replay", config, code=0)
    assert "second" in run("info", code=0).stdout.partition("\n")[0]


def test_a_session_of_several_files_is_one(tmp_path: Path) -> None:
    folder = past_session(tmp_path, 1, parts=3)
    result = run("info", folder)
    assert (result.returncode, result.stderr) == (0, "")
    assert "(3 files, " in result.stdout
    assert "Messages:  30" in result.stdout
    assert len(run("inspect", folder).stdout.splitlines()) == 30
    alone = run("info", folder / "session_1.mcap")
    assert (alone.returncode, alone.stderr) == (0, "")
    assert "give their folder for the whole session" in alone.stdout


def test_the_files_of_a_session_are_recovered_in_place(tmp_path: Path) -> None:
    folder, writer = begin_session(tmp_path, 1, parts=2)
    writer.flush()
    running = run("recover", folder)
    assert running.returncode == 1
    assert "is being written by a running session" in running.stderr
    writer.abandon()
    result = run("recover", folder)
    assert (result.returncode, result.stderr) == (0, "")
    assert result.stdout == f"{folder / 'session_2.mcap'}: 0 messages\n"
    assert "every file is complete" in run("recover", folder).stdout
    assert "recovered in place" in run("recover", folder, "-o", tmp_path / "x").stderr
    assert run("info", folder).returncode == 0


def test_inspect_tells_levels_on_diagnostics(tmp_path: Path) -> None:
    scene = Scene()
    for at, level in ((1, 0), (2, 0), (3, 2), (50, 2), (51, 1)):
        scene.diagnostics(at, lidar=(level, "no data" if level == 2 else ""), gps=(0, "fix"))
    done = run("inspect", scene.record(tmp_path / "session.mcap"), "--node", "lidar")
    assert done.stdout.splitlines() == [
        "     1.000 [lidar] OK",
        "     3.000 [lidar] ERROR: no data",
        "    33.000 [lidar] STALE: it was not reported for 30 s",
        "    50.000 [lidar] ERROR: no data",
        "    51.000 [lidar] WARN",
    ]
    found = run("inspect", tmp_path / "session.mcap", "--level", "error", "--json").stdout
    (first, *_) = map(json.loads, found.splitlines())
    assert (first["event"], first["status"], first["level"]) == ("diagnostics", "lidar", "ERROR")
