"""Nodes that crash alone and containers that freeze, through the real command."""

from __future__ import annotations

import os
import re
import signal
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import psutil
import pytest
from rosbags.highlevel import AnyReader

from play_launch.container.environment import find_allocator
from tests.support.replay import Replay, alive, replaying
from tests.support.tracing import stopped_by_a_tracer

ROOT = Path(__file__).resolve().parents[2]
CONFIG = ROOT / "configs" / "crash_isolation.yaml"

LOADED, UNLOADED, LOAD_FAILED, CRASHED, LOADING = range(5)
STARTED, READY, EXITED, RESTARTING, STOPPING = [
    "started",
    "ready",
    "exited",
    "restarting",
    "stopping",
]
NODE, CONTAINER, PROCESS = range(3)

NEIGHBOURS = {"/talker", "/listener", "/camera", "/detector"}


def write(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


def read_bag(path: Path) -> dict[str, list[Any]]:
    """All messages by topic, read by code that is not ours."""
    found: dict[str, list[Any]] = defaultdict(list)
    with AnyReader([path]) as reader:
        for connection, _, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            found[connection.topic].append(message)
    return found


def components(replay: Replay, node: str, kind: str) -> list[dict[str, Any]]:
    return [
        event
        for event in replay.seen
        if (event["event"], event.get("kind")) == ("component", kind)
        and event["full_node_name"] == node
    ]


def is_component(node: str, kind: str) -> Any:
    return lambda event: (
        event["event"] == "component" and event["full_node_name"] == node and event["kind"] == kind
    )


def is_process(name: str, kind: str) -> Any:
    return lambda event: (
        event["event"] == "process" and event["name"] == name and event["kind"] == kind
    )


def processes(replay: Replay, name: str, kind: str) -> list[dict[str, Any]]:
    return [event for event in replay.seen if is_process(name, kind)(event)]


def read_until_loaded(replay: Replay, *nodes: str) -> None:
    missing = set(nodes)

    def done(event: dict[str, Any]) -> bool:
        if event["event"] == "component" and event["kind"] == "loaded":
            missing.discard(event["full_node_name"])
        return not missing

    replay.read_until(done, f"{missing} loaded")


def pid_of(replay: Replay, container: str) -> int:
    pid: int = processes(replay, container, "started")[-1]["pid"]
    return pid


@pytest.fixture(scope="module")
def crashing(tmp_path_factory: pytest.TempPathFactory) -> Replay:
    """The example, run to its end."""
    with replaying(CONFIG, tmp_path_factory.mktemp("crash_isolation")) as replay:
        replay.read_all()
    return replay


def test_a_node_that_crashes_is_told_with_signal_and_backtrace(crashing: Replay) -> None:
    crashes = components(crashing, "/unlucky", "crashed")
    assert len(crashes) >= 4
    for crash in crashes:
        assert crash["signal"] == signal.SIGSEGV
        assert crash["pid"] not in {0, pid_of(crashing, "/lab")}
        assert crash["backtrace"]
        assert any("libplay_launch_demo" in frame for frame in crash["backtrace"]), crash
    aborts = components(crashing, "/hopeless", "crashed")
    assert {crash["signal"] for crash in aborts} == {signal.SIGABRT}


def test_it_is_loaded_again_each_time_in_a_new_process(crashing: Replay) -> None:
    crashed = components(crashing, "/unlucky", "crashed")
    loaded = components(crashing, "/unlucky", "loaded")
    assert len(crashed) <= len(loaded) <= len(crashed) + 1
    assert [each["attempt"] for each in crashed] == [
        each["attempt"] for each in loaded[: len(crashed)]
    ]
    identities = [(each["pid"], each["start_time"]) for each in loaded]
    assert len(set(identities)) == len(identities)
    assert [(each["pid"], each["start_time"]) for each in crashed] == identities[: len(crashed)]


def test_reloads_are_bounded(crashing: Replay) -> None:
    assert len(components(crashing, "/hopeless", "crashed")) == 4
    assert len(components(crashing, "/hopeless", "loaded")) == 4
    told = [
        event
        for event in crashing.seen
        if event["event"] == "node" and event["node"] == "/hopeless"
    ]
    given_up = [event for event in told if event["state"] == "gave up"]
    assert len(given_up) == 1
    assert "restart limit reached (3 in 60 s)" in given_up[0]["reason"]
    assert "it is loaded again at once" in next(
        event["reason"] for event in told if event["state"] == "crashed"
    )
    assert crashing.process.returncode == 1


def test_the_neighbours_and_the_container_live_on(crashing: Replay) -> None:
    assert len(processes(crashing, "/lab", "started")) == 1
    assert not processes(crashing, "/lab", "restarting")
    (exited,) = processes(crashing, "/lab", "exited")
    assert (exited["exit_code"], exited["signal"]) == (0, 0)
    pids = set()
    for node in NEIGHBOURS:
        (loaded,) = components(crashing, node, "loaded")
        assert not components(crashing, node, "crashed")
        pids.add(loaded["pid"])
    assert len(pids) == len(NEIGHBOURS)
    assert pid_of(crashing, "/lab") not in pids
    summary = crashing.seen[-1]
    lab = next(each for each in summary["containers"] if each["name"] == "/lab")
    details = {each["name"]: each for each in lab["details"]}
    assert {details[node]["pid"] for node in NEIGHBOURS} == pids
    assert details["/unlucky"]["crashes"] == len(components(crashing, "/unlucky", "crashed"))
    assert (details["/hopeless"]["crashes"], details["/hopeless"]["reloads"]) == (4, 3)
    assert all(details[node]["crashes"] == 0 for node in NEIGHBOURS)


def test_the_recording_tells_it_all(crashing: Replay) -> None:
    bag = read_bag(crashing.bag)
    crashes = [each for each in bag["/play_launch/events"] if each.event_type == CRASHED]
    by_node: dict[str, list[Any]] = defaultdict(list)
    for each in crashes:
        by_node[each.full_node_name].append(each)
    assert by_node.keys() == {"/unlucky", "/hopeless"}
    assert len(by_node["/unlucky"]) == len(components(crashing, "/unlucky", "crashed"))
    assert {each.signal for each in by_node["/unlucky"]} == {signal.SIGSEGV}
    assert all(each.backtrace and each.pid and each.start_time for each in crashes)
    states = bag["/play_launch/states"]
    (lab,) = [
        each for each in states if (each.kind, each.name, each.state) == (PROCESS, "/lab", READY)
    ]
    assert lab.reason.startswith("isolated by ")
    (hopeless,) = [each for each in states if each.state == "gave_up"]
    assert (hopeless.kind, hopeless.name, hopeless.container) == (NODE, "/hopeless", "/lab")
    assert (hopeless.crashes, hopeless.restarts) == (4, 3)
    (running,) = [
        each
        for each in states
        if (each.kind, each.name, each.state) == (CONTAINER, "/lab", "running")
    ]
    assert running.mechanism in {"shared_memory", "process"}


@pytest.mark.parametrize("listener", ["listener", "far_listener"])
def test_not_a_beat_is_missed(crashing: Replay, listener: str) -> None:
    lines = [each.msg for each in read_bag(crashing.bag)["/play_launch/output"]]
    pattern = re.compile(rf"\[{listener}\].*I heard 'Still here: (\d+)'")
    heard = [int(found[1]) for line in lines if (found := pattern.search(line))]
    # It tells of each tenth message that it hears; had it missed one, the numbers would shift.
    assert len(heard) > 10
    assert heard == list(range(heard[0], heard[0] + 10 * len(heard), 10))


def test_images_go_by_pointer_from_process_to_process(crashing: Replay) -> None:
    lab = next(each for each in crashing.seen[-1]["containers"] if each["name"] == "/lab")
    if lab["mechanism"] != "shared_memory":
        pytest.skip(f"nodes are isolated by {lab['mechanism']} here")
    lines = [each.msg for each in read_bag(crashing.bag)["/play_launch/output"]]
    reports = [line for line in lines if "by_pointer=" in line]
    assert len(reports) >= 3
    for report in reports:
        counts = dict(part.split("=") for part in report.split() if "=" in part)
        assert counts["images"] == counts["by_pointer"], report


ON_CRASH = """
version: 1
containers:
  - name: lab
    container_type: {kind}
    isolation: {isolation}
    on_crash: {on_crash}
    composable_nodes:
      - {{package: play_launch_demo, plugin: "play_launch_demo::Talker", name: talker}}
      - package: play_launch_demo
        plugin: play_launch_demo::Crasher
        name: crasher
        parameters: {{how: {how}, after: 0.2}}
  - name: bystander
    composable_nodes:
      - {{package: play_launch_demo, plugin: "play_launch_demo::Listener", name: witness}}
"""


def on_crash(
    path: Path,
    policy: str,
    *,
    kind: str = "isolated",
    how: str = "segv",
    isolation: str = "auto",
) -> Path:
    text = ON_CRASH.format(on_crash=policy, kind=kind, how=how, isolation=isolation)
    return write(path / f"{policy}.yaml", text)


@pytest.mark.parametrize("isolation", ["shared_memory", "process"])
@pytest.mark.parametrize("kind", ["isolated", "isolated_mt"])
def test_a_crash_stays_alone_in_every_kind_of_isolation(
    kind: str, isolation: str, tmp_path: Path
) -> None:
    config = on_crash(tmp_path, "reload", kind=kind, isolation=isolation)
    with replaying(config, tmp_path / "logs") as replay:
        for _ in range(3):
            crash = replay.read_until(is_component("/crasher", "crashed"), "a crash")
            assert crash["signal"] == signal.SIGSEGV
            again = replay.read_until(is_component("/crasher", "loaded"), "the reload")
            assert again["pid"] not in {crash["pid"], pid_of(replay, "/lab")}
        (talker,) = components(replay, "/talker", "loaded")
        assert psutil.pid_exists(talker["pid"])
        ready = processes(replay, "/lab", "ready")
        assert [each["message"].split(",")[0] for each in ready] == [f"{kind} by {isolation}"]
        replay.process.send_signal(signal.SIGTERM)
        replay.read_all()
    assert replay.process.returncode == 128 + signal.SIGTERM
    assert len(processes(replay, "/lab", "started")) == 1


def test_a_node_that_is_killed_from_outside_comes_back(tmp_path: Path) -> None:
    config = on_crash(tmp_path, "reload", how="segv")
    with replaying(config, tmp_path / "logs") as replay:
        talker = replay.read_until(is_component("/talker", "loaded"), "the talker")
        os.kill(talker["pid"], signal.SIGKILL)
        crash = replay.read_until(is_component("/talker", "crashed"), "its death")
        assert (crash["pid"], crash["signal"]) == (talker["pid"], signal.SIGKILL)
        # Should a lock have died with it, its container is started anew first.
        replay.read_until(is_component("/talker", "loaded"), "its return")


def test_ignored_it_stays_away(tmp_path: Path) -> None:
    config = on_crash(tmp_path, "ignore", kind="isolated_mt", how="exception")
    with replaying(config, tmp_path / "logs", "--duration", "12s") as replay:
        replay.read_all()
    assert len(components(replay, "/crasher", "crashed")) == 1
    assert len(components(replay, "/crasher", "loaded")) == 1
    assert replay.process.returncode == 1
    lab = next(each for each in replay.seen[-1]["containers"] if each["name"] == "/lab")
    assert (lab["loaded"], lab["failed"], lab["restarts"]) == (1, ["/crasher"], 0)


def test_its_container_is_stopped_and_the_others_run_on(tmp_path: Path) -> None:
    config = on_crash(tmp_path, "stop_container")
    with replaying(config, tmp_path / "logs", "--duration", "12s") as replay:
        exited = replay.read_until(is_process("/lab", "exited"), "the container's end")
        assert (exited["exit_code"], exited["signal"]) == (0, 0)
        assert psutil.pid_exists(pid_of(replay, "/bystander"))
        replay.read_all()
    assert len(processes(replay, "/lab", "started")) == 1
    assert not processes(replay, "/lab", "restarting")
    assert replay.seen[-1]["exit_code"] == replay.process.returncode == 1
    states = {each["name"]: each["state"] for each in replay.seen[-1]["containers"]}
    assert states == {"/lab": "stopped", "/bystander": "running"}


def test_everything_is_shut_down(tmp_path: Path) -> None:
    config = on_crash(tmp_path, "shutdown", how="abrt")
    with replaying(config, tmp_path / "logs") as replay:
        replay.read_all()
    assert replay.process.returncode == 1
    assert len(components(replay, "/crasher", "crashed")) == 1
    stopping = processes(replay, "/bystander", "stopping")
    assert "/crasher crashed: exited with signal 6" in stopping[0]["message"]


FROZEN = """
version: 1
composable_node_loading:
  restart: {{max_restarts: 2, within: 60 s, backoff: {{initial: 50 ms, maximum: 100 ms}}}}
containers:
  - name: victim
    container_type: {kind}
    composable_nodes:
      - {{package: play_launch_demo, plugin: "play_launch_demo::Talker", name: talker}}
      - {{package: play_launch_demo, plugin: "play_launch_demo::Listener", name: listener}}
  - name: bystander
    composable_nodes:
      - {{package: play_launch_demo, plugin: "play_launch_demo::Listener", name: witness}}
"""

FROZEN_TOO = """
  - name: second
    container_type: {kind}
    composable_nodes:
      - {{package: play_launch_demo, plugin: "play_launch_demo::Listener", name: another}}
"""


@pytest.mark.parametrize("kind", ["standard", "isolated"])
def test_a_frozen_container_is_killed_and_comes_back_with_its_nodes(
    kind: str, tmp_path: Path
) -> None:
    config = write(tmp_path / "frozen.yaml", FROZEN.format(kind=kind))
    with replaying(config, tmp_path / "logs") as replay:
        read_until_loaded(replay, "/talker", "/listener", "/witness")
        first, bystander = pid_of(replay, "/victim"), pid_of(replay, "/bystander")
        has_allocator = re.search("(mimalloc|jemalloc)", Path(f"/proc/{first}/maps").read_text())
        assert bool(has_allocator) is (kind == "isolated" and bool(find_allocator().library))
        family = [psutil.Process(first), *psutil.Process(first).children(recursive=True)]
        os.kill(first, signal.SIGSTOP)
        killed = replay.read_until(is_process("/victim", "stopping"), "that it is noticed")
        assert "it is frozen: no answer for 3 s" in killed["message"]
        gone = replay.read_until(is_process("/victim", "exited"), "its end")
        assert (gone["pid"], gone["signal"]) == (first, signal.SIGKILL)
        replay.read_until(is_process("/victim", "started"), "its restart")
        read_until_loaded(replay, "/talker", "/listener")
        assert pid_of(replay, "/victim") != first
        assert pid_of(replay, "/bystander") == bystander
        assert not alive(family)
        replay.process.send_signal(signal.SIGTERM)
        replay.read_all()
    assert replay.process.returncode == 128 + signal.SIGTERM
    chain = [
        each.state
        for each in read_bag(replay.bag)["/play_launch/states"]
        if each.kind == PROCESS and each.name == "/victim"
    ]
    assert chain == [
        *(STARTED, READY, STOPPING, EXITED, RESTARTING),
        *(STARTED, READY, STOPPING, EXITED),
    ]


@pytest.mark.parametrize("kind", ["standard", "isolated"])
def test_a_container_that_a_debugger_stops_is_not_taken_for_frozen(
    kind: str, tmp_path: Path
) -> None:
    config = write(tmp_path / "traced.yaml", FROZEN.format(kind=kind))
    with replaying(config, tmp_path / "logs") as replay:
        read_until_loaded(replay, "/talker", "/listener", "/witness")
        victim, bystander = pid_of(replay, "/victim"), pid_of(replay, "/bystander")
        with stopped_by_a_tracer(victim) as tracer:
            said = replay.read_until(is_log("stopped by", "is killed"), "that it is noticed")
            assert f"(pid {tracer}), which is no freeze" in said["message"]
            # The one that is really frozen, and whose silence begins later, is killed meanwhile.
            os.kill(bystander, signal.SIGSTOP)
            replay.read_until(is_process("/bystander", "exited"), "the end of a frozen one")
            assert psutil.Process(victim).status() == psutil.STATUS_TRACING_STOP
        said = replay.read_until(is_log("/victim answers again", "/victim is killed"), "an answer")
        assert "answers again" in said["message"]
        replay.process.send_signal(signal.SIGTERM)
        replay.read_all()
        assert not processes(replay, "/victim", "restarting")


def is_log(*any_of: str) -> Callable[[dict[str, Any]], bool]:
    return lambda event: (
        event["event"] == "log" and any(each in event["message"] for each in any_of)
    )


def test_without_an_allocator_it_works_and_warns_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PLAY_LAUNCH_ALLOCATOR", "/nowhere/libmimalloc.so.2")
    config = write(
        tmp_path / "bare.yaml", FROZEN.format(kind="isolated") + FROZEN_TOO.format(kind="isolated")
    )
    with replaying(config, tmp_path / "logs") as replay:
        read_until_loaded(replay, "/talker", "/listener", "/witness", "/another")
        replay.process.send_signal(signal.SIGTERM)
        replay.read_all()
    warnings = [
        event["message"]
        for event in replay.seen
        if event["event"] == "log" and "PLAY_LAUNCH_ALLOCATOR names" in event["message"]
    ]
    assert len(warnings) == 1
    assert "pip install cmeel-mimalloc" in warnings[0]


def test_no_isolated_node_outlives_a_supervisor_that_is_killed(tmp_path: Path) -> None:
    config = write(tmp_path / "orphans.yaml", FROZEN.format(kind="isolated"))
    with replaying(config, tmp_path / "logs") as replay:
        read_until_loaded(replay, "/talker", "/listener", "/witness")
        started = replay.descendants()
        # The two containers, and a process for each of the victim's nodes.
        assert len(started) >= 4
        os.kill(replay.pid, signal.SIGKILL)
        replay.process.wait()
        _, left = psutil.wait_procs(started, timeout=60)
        assert not left
