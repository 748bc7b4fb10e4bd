"""Nodes that crash alone, containers that freeze, and locks of the dead, by the real command."""

from __future__ import annotations

import os
import re
import signal
from collections import defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest

from play_launch.container.environment import find_allocator
from tests.support.replay import Replay, alive, is_, recorded, replaying, run
from tests.support.scenes import container, ending, node, written
from tests.support.tracing import stopped_by_a_tracer

ROOT = Path(__file__).resolve().parents[2]
CONFIG = ROOT / "configs" / "crash_isolation.yaml"
CRASHED = 3
NODE, CONTAINER, PROCESS = range(3)
NEIGHBOURS = {"/talker", "/listener", "/camera", "/detector"}
STATES, OUTPUT = "/play_launch/states", "/play_launch/output"


def components(replay: Replay, name: str, kind: str) -> list[dict[str, Any]]:
    return replay.told(event="component", full_node_name=name, kind=kind)


def processes(replay: Replay, name: str, kind: str) -> list[dict[str, Any]]:
    return replay.told(event="process", name=name, kind=kind)


def read_until_loaded(replay: Replay, *names: str) -> None:
    replay.read_until_states(dict.fromkeys(names, "loaded"))


def pid_of(replay: Replay, name: str) -> int:
    pid: int = processes(replay, name, "started")[-1]["pid"]
    return pid


@pytest.fixture(scope="module")
def crashing(tmp_path_factory: pytest.TempPathFactory) -> Replay:
    """The example, run to its end; longer where programs are slow."""
    folder = tmp_path_factory.mktemp("crash_isolation")
    seconds = 15 * int(os.environ.get("SLOW", "1"))
    text = CONFIG.read_text("utf-8")
    assert "duration: 15 s" in text
    config = folder / CONFIG.name
    config.write_text(text.replace("duration: 15 s", f"duration: {seconds} s"), "utf-8")
    with replaying(config, folder / "logs") as replay:
        replay.read_all()
    return replay


def test_a_crash_is_reported_with_signal_and_backtrace(crashing: Replay) -> None:
    crashes = components(crashing, "/unlucky", "crashed")
    assert len(crashes) >= 4
    for crash in crashes:
        assert crash["signal"] == signal.SIGSEGV
        assert crash["pid"] not in {0, pid_of(crashing, "/lab")}
        assert any("libplay_launch_demo" in frame for frame in crash["backtrace"]), crash
    aborts = components(crashing, "/hopeless", "crashed")
    assert {crash["signal"] for crash in aborts} == {signal.SIGABRT}


def test_a_node_is_reloaded_each_time_in_a_new_process(crashing: Replay) -> None:
    crashed = components(crashing, "/unlucky", "crashed")
    loaded = components(crashing, "/unlucky", "loaded")
    assert len(crashed) <= len(loaded) <= len(crashed) + 1
    lives = [(each["attempt"], each["pid"], each["start_time"]) for each in loaded]
    assert len(set(lives)) == len(lives)
    ends = [(each["attempt"], each["pid"], each["start_time"]) for each in crashed]
    assert ends == lives[: len(crashed)]


def test_reloads_are_bounded(crashing: Replay) -> None:
    assert len(components(crashing, "/hopeless", "crashed")) == 4
    assert len(components(crashing, "/hopeless", "loaded")) == 4
    (given_up,) = crashing.told(event="node", node="/hopeless", state="gave up")
    assert "restart limit reached (3 in 60 s)" in given_up["reason"]
    first, *_ = crashing.told(event="node", node="/hopeless", state="crashed")
    assert "it is loaded again at once" in first["reason"]
    assert crashing.process.returncode == 1


def test_other_nodes_and_the_container_run_on(crashing: Replay) -> None:
    why = [each["message"] for each in crashing.told(event="process", name="/lab")]
    assert len(processes(crashing, "/lab", "started")) == 1, why
    assert not processes(crashing, "/lab", "restarting")
    (exited,) = processes(crashing, "/lab", "exited")
    assert (exited["exit_code"], exited["signal"]) == (0, 0)
    pids = set()
    for name in NEIGHBOURS:
        (loaded,) = components(crashing, name, "loaded")
        assert not components(crashing, name, "crashed")
        pids.add(loaded["pid"])
    assert len(pids) == len(NEIGHBOURS)
    assert pid_of(crashing, "/lab") not in pids
    lab = next(each for each in crashing.seen[-1]["containers"] if each["name"] == "/lab")
    details = {each["name"]: each for each in lab["details"]}
    assert {details[name]["pid"] for name in NEIGHBOURS} == pids
    # The details are those of the moment at which the stop began; one more crash may follow.
    during_stop = lab["crashed_when_stopped"].count("/unlucky")
    crashes = len(components(crashing, "/unlucky", "crashed"))
    assert details["/unlucky"]["crashes"] + during_stop == crashes
    assert (details["/hopeless"]["crashes"], details["/hopeless"]["reloads"]) == (4, 3)
    assert all(details[name]["crashes"] == 0 for name in NEIGHBOURS)


def test_the_recording_has_crashes_and_states(crashing: Replay) -> None:
    crashes = [
        each for each in recorded(crashing.bag, "/play_launch/events") if each.event_type == CRASHED
    ]
    by_node: dict[str, list[Any]] = defaultdict(list)
    for each in crashes:
        by_node[each.full_node_name].append(each)
    assert by_node.keys() == {"/unlucky", "/hopeless"}
    assert len(by_node["/unlucky"]) == len(components(crashing, "/unlucky", "crashed"))
    assert {each.signal for each in by_node["/unlucky"]} == {signal.SIGSEGV}
    assert all(each.backtrace and each.pid and each.start_time for each in crashes)
    states = {(each.kind, each.name, each.state): each for each in recorded(crashing.bag, STATES)}
    assert states[PROCESS, "/lab", "ready"].reason.startswith("isolated by ")
    hopeless = states[NODE, "/hopeless", "gave_up"]
    assert (hopeless.container, hopeless.crashes, hopeless.restarts) == ("/lab", 4, 3)
    running = states[CONTAINER, "/lab", "running"]
    assert running.mechanism in {"shared_memory", "process"}


@pytest.mark.parametrize("listener", ["listener", "far_listener"])
def test_no_message_is_missed(crashing: Replay, listener: str) -> None:
    lines = [each.msg for each in recorded(crashing.bag, OUTPUT)]
    pattern = re.compile(rf"\[{listener}\].*I heard 'Still here: (\d+)'")
    heard = [int(found[1]) for line in lines if (found := pattern.search(line))]
    # It logs each tenth message; had it missed one, the numbers would shift.
    assert len(heard) > 10, lines[:200]
    assert heard == list(range(heard[0], heard[0] + 10 * len(heard), 10))


def lab(on_crash: str, how: str, name: str = "lab", **keys: Any) -> dict[str, Any]:
    crasher = node(f"{name}_crasher", "Crasher", parameters={"how": how, "after": 0.2})
    nodes = [node(f"{name}_talker"), crasher]
    return container(name, *nodes, container_type="isolated", on_crash=on_crash, **keys)


BYSTANDER = container("bystander", node("witness", "Listener"))


def test_a_crash_may_be_ignored_or_stop_its_container(tmp_path: Path) -> None:
    containers = [
        lab("ignore", "exception", "ignoring"),
        lab("stop_container", "segv", "stopping"),
        BYSTANDER,
    ]
    end = tmp_path / "end"
    config = written(tmp_path, containers=containers, nodes=[ending(end)])
    with replaying(config, tmp_path / "logs") as replay:
        exited = replay.until(name="/stopping", kind="exited")
        assert (exited["exit_code"], exited["signal"]) == (0, 0)
        assert psutil.pid_exists(pid_of(replay, "/bystander"))
        if not components(replay, "/ignoring_crasher", "crashed"):
            replay.until(full_node_name="/ignoring_crasher", kind="crashed")
        end.touch()
        replay.read_all()
    assert replay.seen[-1]["exit_code"] == replay.process.returncode == 1
    for name in ("/ignoring", "/stopping"):
        assert len(components(replay, f"{name}_crasher", "crashed")) == 1
        assert len(components(replay, f"{name}_crasher", "loaded")) == 1
        assert len(processes(replay, name, "started")) == 1
    ends = {each["name"]: each for each in replay.seen[-1]["containers"]}
    assert {name: each["state"] for name, each in ends.items()} == {
        "/ignoring": "running",
        "/stopping": "stopped",
        "/bystander": "running",
    }
    assert (ends["/ignoring"]["loaded"], ends["/ignoring"]["failed"]) == (1, ["/ignoring_crasher"])


def test_a_crash_may_shut_everything_down(tmp_path: Path) -> None:
    config = written(tmp_path, containers=[lab("shutdown", "abrt"), BYSTANDER])
    with replaying(config, tmp_path / "logs") as replay:
        replay.read_all()
    assert replay.process.returncode == 1
    assert len(components(replay, "/lab_crasher", "crashed")) == 1
    stopping = processes(replay, "/bystander", "stopping")
    assert "/lab_crasher crashed: SIGABRT (" in stopping[0]["message"]


def frozen(folder: Path, kind: str, *more: dict[str, Any]) -> Path:
    victim = container("victim", node("talker"), node("listener", "Listener"), container_type=kind)
    backoff = {"initial": "50 ms", "maximum": "100 ms"}
    loading = {"restart": {"max_restarts": 2, "within": "60 s", "backoff": backoff}}
    containers = [victim, BYSTANDER, *more]
    return written(folder, composable_node_loading=loading, containers=containers)


@pytest.mark.parametrize("kind", ["standard", "isolated"])
def test_a_frozen_container_is_killed_and_restarted_with_its_nodes(
    kind: str, tmp_path: Path
) -> None:
    with replaying(frozen(tmp_path, kind), tmp_path / "logs") as replay:
        read_until_loaded(replay, "/talker", "/listener", "/witness")
        first, bystander = pid_of(replay, "/victim"), pid_of(replay, "/bystander")
        has_allocator = re.search("(mimalloc|jemalloc)", Path(f"/proc/{first}/maps").read_text())
        assert bool(has_allocator) is (kind == "isolated" and bool(find_allocator().library))
        family = [psutil.Process(first), *psutil.Process(first).children(recursive=True)]
        os.kill(first, signal.SIGSTOP)
        killed = replay.until(name="/victim", kind="stopping")
        assert "it is frozen: no answer for 3 s" in killed["message"]
        gone = replay.until(name="/victim", kind="exited")
        assert (gone["pid"], gone["signal"]) == (first, signal.SIGKILL)
        replay.until(name="/victim", kind="started")
        read_until_loaded(replay, "/talker", "/listener")
        assert pid_of(replay, "/victim") != first
        assert pid_of(replay, "/bystander") == bystander
        assert not alive(family)
        replay.process.send_signal(signal.SIGTERM)
        replay.read_all()
    assert replay.process.returncode == 128 + signal.SIGTERM
    chain = [
        each.state
        for each in recorded(replay.bag, STATES)
        if (each.kind, each.name) == (PROCESS, "/victim")
    ]
    assert chain == [
        *("started", "ready", "stopping", "exited", "restarting"),
        *("started", "ready", "stopping", "exited"),
    ]


@pytest.mark.parametrize("kind", ["standard", "isolated"])
def test_a_container_that_a_debugger_stops_is_not_taken_for_frozen(
    kind: str, tmp_path: Path
) -> None:
    with replaying(frozen(tmp_path, kind), tmp_path / "logs") as replay:
        read_until_loaded(replay, "/talker", "/listener", "/witness")
        victim, bystander = pid_of(replay, "/victim"), pid_of(replay, "/bystander")
        with stopped_by_a_tracer(victim) as tracer:
            said = replay.read_until(is_log("stopped by", "is killed"), "a report")
            assert f"(pid {tracer}), which is no freeze" in said["message"]
            # The one that is really frozen, and whose silence begins later, is killed meanwhile.
            os.kill(bystander, signal.SIGSTOP)
            replay.until(name="/bystander", kind="exited")
            assert psutil.Process(victim).status() == psutil.STATUS_TRACING_STOP
        said = replay.read_until(is_log("/victim answers again", "/victim is killed"), "an answer")
        assert "answers again" in said["message"]
        replay.process.send_signal(signal.SIGTERM)
        replay.read_all()
        assert not processes(replay, "/victim", "restarting")


def is_log(*any_of: str) -> Callable[[dict[str, Any]], bool]:
    is_any = is_(event="log")
    return lambda event: is_any(event) and any(each in event["message"] for each in any_of)


def test_without_an_allocator_there_is_one_warning(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PLAY_LAUNCH_ALLOCATOR", "/nowhere/libmimalloc.so.2")
    second = container("second", node("another", "Listener"), container_type="isolated")
    with replaying(frozen(tmp_path, "isolated", second), tmp_path / "logs") as replay:
        read_until_loaded(replay, "/talker", "/listener", "/witness", "/another")
    warnings = [
        event["message"] for event in replay.seen if is_log("PLAY_LAUNCH_ALLOCATOR names")(event)
    ]
    assert len(warnings) == 1
    assert "pip install cmeel-mimalloc" in warnings[0]


NODES = ("/holder", "/waiting", "/busy")


def configuration(path: Path, kind: str) -> Path:
    lockers = [
        node("holder", "Locker", parameters={"lock": "mutex", "hold_from": 1}),
        node("waiting", "Locker", parameters={"lock": "mutex", "rate": 1000.0}),
        node("busy", "Locker", parameters={"lock": "none", "hold_from": 1}),
    ]
    how = {"container_type": kind, "isolation": "shared_memory", "on_crash": "ignore"}
    return written(path, containers=[container("lab", *lockers, **how)])


def keeping(replay: Replay) -> int:
    """How many nodes have said that they hold a lock now."""
    lines = (event["text"] for event in replay.seen if event["event"] == "output")
    return sum("Keeping the lock" in line for line in lines)


@pytest.fixture(scope="module")
def left_alone(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Replay]:
    """A run whose nodes hang and do not die; it takes its time beside the other tests."""
    folder = tmp_path_factory.mktemp("left_alone")
    with replaying(configuration(folder, "isolated"), folder / "logs") as replay:
        yield replay


@pytest.mark.usefixtures("left_alone")
@pytest.mark.parametrize("kind", ["isolated", "isolated_mt"])
def test_a_container_whose_living_nodes_wait_for_a_dead_one_is_started_anew(
    kind: str, tmp_path: Path
) -> None:
    with replaying(configuration(tmp_path, kind), tmp_path / "logs") as replay:
        first = replay.read_until_up(*NODES)
        started = replay.told(name="/lab", kind="started")[0]
        # The busy one keeps a lock as well, of no process.
        if keeping(replay) < 2:
            replay.read_until(lambda _: keeping(replay) == 2, "that the lock is held")
        family = [psutil.Process(first[name]["pid"]) for name in NODES]
        os.kill(first["/holder"]["pid"], signal.SIGKILL)
        stopping = replay.until(name="/lab", kind="stopping")
        assert "a node died with a lock" in stopping["message"]
        assert f"of process {first['/waiting']['pid']} waits" in stopping["message"]
        assert f"held by process {first['/holder']['pid']}" in stopping["message"]
        exited = replay.until(name="/lab", kind="exited")
        assert (exited["pid"], exited["signal"]) == (started["pid"], signal.SIGKILL)
        second = replay.read_until_up(*NODES)
        assert not alive(family)
        assert not {each["pid"] for each in first.values()} & {
            each["pid"] for each in second.values()
        }
        replay.process.send_signal(signal.SIGTERM)
        replay.read_all()
    assert replay.process.returncode == 128 + signal.SIGTERM
    crashes = replay.told(event="component", kind="crashed")
    assert [(each["full_node_name"], each["signal"]) for each in crashes] == [
        ("/holder", signal.SIGKILL)
    ]
    chain = [
        each.state
        for each in recorded(replay.bag, "/play_launch/states")
        if (each.kind, each.name) == (PROCESS, "/lab")
    ]
    assert chain == [
        *("started", "ready", "stopping", "exited", "restarting"),
        *("started", "ready", "stopping", "exited"),
    ]
    explained = run("explain", replay.bag, code=1).stdout
    assert "/holder in /lab crashed" in explained
    assert "/lab was killed: a node died with a lock" in explained
    assert "Also affected: /lab, /waiting" in explained


def test_nodes_that_hang_without_a_death_are_told_of_and_left_alone(left_alone: Replay) -> None:
    left_alone.read_until_up(*NODES)
    told: set[str] = set()

    def all_told(event: dict[str, Any]) -> bool:
        if event["event"] == "node" and "blocked in a callback" in event["reason"]:
            told.add(event["node"])
        return told == set(NODES)

    # The holder sleeps in a callback, one waits for its lock, one is just busy.
    left_alone.read_until(all_told, "that they are busy")
    left_alone.process.send_signal(signal.SIGTERM)
    left_alone.read_all()
    explained = run("explain", left_alone.bag, code=1).stdout
    for each in NODES:
        assert f"{each} in /lab was blocked in a callback" in explained
    assert len(left_alone.told(name="/lab", kind="started")) == 1
    assert not left_alone.told(name="/lab", kind="restarting")
