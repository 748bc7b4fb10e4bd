"""Isolated containers in one process (`consolidate`), by the real command."""

from __future__ import annotations

import json
import os
import re
import signal
from pathlib import Path
from typing import Any

import psutil
import pytest

from tests.support.control_groups import control_group, group_of
from tests.support.replay import Replay, alive, is_, recorded, replaying, run
from tests.support.ros import Probe
from tests.support.scenes import container, node, written
from tests.support.waiting import until

QUICK = {"max_restarts": 3, "within": "60 s", "backoff": {"initial": "50 ms", "maximum": "100 ms"}}
NAMES = ("/left", "/far/right", "/third")
NODES = ("/talker", "/listener", "/crasher")
ALL = (*NAMES, *NODES)


def system(path: Path, *more: dict[str, Any], **keys: Any) -> Path:
    """Three containers with a node each in one process, and others."""
    containers = [
        container("left", node("talker")),
        container("right", node("listener", "Listener"), namespace="/far"),
        container("third", node("crasher", "Crasher"), restart={"max_restarts": 2}),
        *more,
    ]
    loading = {"container_type": "isolated", "consolidate": True, "restart": QUICK}
    loading |= keys.pop("loading", {})
    return written(path, containers=containers, composable_node_loading=loading, **keys)


def up(replay: Replay, *names: str) -> dict[str, int]:
    """The pids of what runs, once it does."""
    replay.read_until_up(*names)
    replay.until_operable()
    return replay.pids()


def ended(replay: Replay) -> dict[str, dict[str, Any]]:
    """Read until each of the three has exited; those events."""
    found: dict[str, dict[str, Any]] = {}

    def is_last(event: dict[str, Any]) -> bool:
        if is_(event="process", kind="exited")(event):
            found[event["name"]] = event
        return found.keys() >= set(NAMES)

    replay.read_until(is_last, "the end of all containers")
    return {name: found[name] for name in NAMES}


def test_containers_that_are_alike_have_one_process_and_stay_containers(tmp_path: Path) -> None:
    alone = container("alone", node("other"), consolidate=False)
    unlike = container("unlike", node("another"), environment={"COLOUR": "red"})
    config = system(tmp_path, alone, unlike)
    with replaying(config, tmp_path / "logs") as replay:
        pids = up(replay, *ALL, "/alone", "/unlike", "/other", "/another")
        shared = pids["/left"]
        assert [pids[name] for name in NAMES] == [shared] * 3
        assert len({shared, pids["/alone"], pids["/unlike"]}) == 3
        assert len({pids[name] for name in NODES} | {shared}) == 4
        assert {psutil.Process(pids[name]).ppid() for name in NODES} == {shared}
        with Probe() as probe:
            for name, its in zip(NAMES, NODES, strict=True):
                assert [found for found, _ in probe.nodes(name)] == [its]
            more = probe.load("Talker", container="/third", node_name="guest")
            assert more.success, more.error_message
            assert {found for found, _ in probe.nodes("/third")} == {"/crasher", "/guest"}
            assert [found for found, _ in probe.nodes("/left")] == ["/talker"]
            assert probe.unload(more.unique_id, container="/third").success
            refused = probe.unload(more.unique_id, container="/left")
            assert not refused.success
        family = replay.descendants()
        replay.process.send_signal(signal.SIGINT)
        replay.read_all()
    assert not alive(family)
    exits = [each for each in replay.told(event="process", kind="exited") if each["name"] in NAMES]
    assert sorted(each["name"] for each in exits) == sorted(NAMES)
    assert {(each["exit_code"], each["signal"]) for each in exits} == {(0, 0)}


def test_messages_go_by_pointer_from_one_of_the_containers_to_another(tmp_path: Path) -> None:
    by_pointer = {"extra_arguments": {"use_intra_process_comms": True}}
    camera = container("eye", node("camera", "ImageSource", **by_pointer))
    detector = container("brain", node("detector", "ImageSink", **by_pointer))
    with replaying(system(tmp_path, camera, detector), tmp_path / "logs") as replay:
        said = replay.read_until(lambda event: "by_pointer=" in event.get("text", ""), "images")
        found = dict(each.split("=") for each in said["text"].split() if "=" in each)
        assert int(found["by_pointer"]) == int(found["images"]) > 0
        replay.process.send_signal(signal.SIGTERM)
        replay.read_all()


def test_what_a_node_logs_is_told_of_its_container(tmp_path: Path) -> None:
    with replaying(system(tmp_path), tmp_path / "logs") as replay:
        said: dict[str, str] = {}

        def is_last(event: dict[str, Any]) -> bool:
            for name in ("talker", "listener"):
                if event["event"] == "output" and f"[{name}]: " in event["text"]:
                    said.setdefault(name, event["process"])
            return len(said) == 2

        replay.read_until(is_last, "lines of both")
        assert said == {"talker": "/left", "listener": "/far/right"}
        replay.ask("restart", "/left", code=0)
        said.clear()
        replay.read_until(is_last, "lines of both")
        assert said == {"talker": "/left", "listener": "/far/right"}
        replay.process.send_signal(signal.SIGTERM)
        replay.read_all()


def test_a_crash_and_a_restart_concern_one_container_alone(tmp_path: Path) -> None:
    with replaying(system(tmp_path), tmp_path / "logs") as replay:
        before = up(replay, *ALL)
        os.kill(before["/crasher"], signal.SIGSEGV)
        replay.until(event="component", full_node_name="/crasher", kind="crashed")
        replay.until(event="node", node="/crasher", state="loaded")
        replay.ask("restart", "/left", code=0)
        replay.read_until_up("/talker")
        after = replay.pids()
        changed = {name for name in ALL if before[name] != after[name]}
        assert changed == {"/crasher", "/talker"}
        replay.ask("stop", "/third", code=0)
        replay.ask("start", "/third", code=0)
        replay.read_until_up("/crasher")
        assert replay.pids()["/third"] == before["/third"]
        replay.process.send_signal(signal.SIGTERM)
        replay.read_all()
    restarts = replay.told(event="process", kind="restarting")
    assert not restarts
    states = recorded(replay.bag, "/play_launch/states")
    assert {each.name for each in states if each.state == "crashed"} == {"/crasher"}


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_the_end_of_the_process_is_that_of_each_container_and_each_comes_back(
    number: signal.Signals, tmp_path: Path
) -> None:
    with replaying(system(tmp_path), tmp_path / "logs") as replay:
        before = up(replay, *ALL)
        family = psutil.Process(before["/left"]).children(recursive=True)
        os.kill(before["/left"], number)
        for name, event in ended(replay).items():
            if number is signal.SIGKILL:
                assert event["signal"] == number
                others = [each for each in NAMES if each != name]
                assert any(other in event["message"] for other in others) or name == NAMES[-1]
            else:
                assert (event["exit_code"], event["signal"]) == (0, 0)
        replay.read_until_up(*ALL)
        after = replay.pids()
        assert len({after[name] for name in NAMES}) == 1
        assert after["/left"] != before["/left"]
        assert not alive(family)
        replay.process.send_signal(signal.SIGTERM)
        replay.read_all()


def test_what_cannot_be_taken_apart_gives_its_container_a_new_process(tmp_path: Path) -> None:
    dead = {"parameters": {"in_constructor": True}, "on_crash": "ignore"}
    half = container("half", node("half_built", "Crasher", **dead), node("guest"))
    with replaying(system(tmp_path, half), tmp_path / "logs") as replay:
        before = up(replay, *ALL, "/half", "/guest")
        assert before["/half"] == before["/left"]
        has_failed = {"event": "component", "kind": "load_failed"}
        if not replay.told(**has_failed):
            replay.until(**has_failed)
        replay.ask("restart", "/half")
        until(lambda: replay.pids().get("/guest") not in {None, before["/guest"]}, "a guest")
        after = replay.pids()
        assert after["/half"] != before["/half"]
        assert {name: after[name] for name in ALL} == {name: before[name] for name in ALL}
        replay.process.send_signal(signal.SIGTERM)
        replay.read_all()


def test_a_frozen_process_is_killed_and_all_come_back(tmp_path: Path) -> None:
    with replaying(system(tmp_path), tmp_path / "logs") as replay:
        before = up(replay, *ALL)
        os.kill(before["/left"], signal.SIGSTOP)
        exits = ended(replay)
        assert {each["signal"] for each in exits.values()} == {signal.SIGKILL}
        replay.read_until_up(*ALL)
        after = replay.pids()
        assert len({after[name] for name in NAMES}) == 1 != len({before["/left"], after["/left"]})
        replay.process.send_signal(signal.SIGTERM)
        replay.read_all()


def test_a_lock_that_a_dead_node_holds_ends_the_process_of_all(tmp_path: Path) -> None:
    lockers = [
        node("holder", "Locker", parameters={"lock": "mutex", "hold_from": 1}),
        node("waiting", "Locker", parameters={"lock": "mutex", "rate": 1000.0}),
    ]
    lab = container("lab", *lockers, on_crash="ignore")
    config = system(tmp_path, lab, loading={"isolation": "shared_memory"})
    with replaying(config, tmp_path / "logs") as replay:
        before = up(replay, *ALL, "/lab", "/holder", "/waiting")
        os.kill(before["/holder"], signal.SIGKILL)
        stopping = replay.until(name="/lab", kind="stopping")
        assert "a node died with a lock" in stopping["message"]
        exits = ended(replay)
        messages = {name: each["message"] for name, each in exits.items()}
        assert all("/lab" in each for each in messages.values()), messages
        replay.read_until_up(*ALL, "/lab", "/holder", "/waiting")
        after = replay.pids()
        assert len({after[name] for name in (*NAMES, "/lab")}) == 1
        assert after["/left"] != before["/left"]
        replay.process.send_signal(signal.SIGTERM)
        replay.read_all()


def test_a_node_that_shuts_the_context_down_ends_alone(tmp_path: Path) -> None:
    quitter = container("quitting", node("quitter", "Quitter"))
    with replaying(system(tmp_path, quitter), tmp_path / "logs") as replay:
        before = up(replay, *ALL)
        quits = {"full_node_name": "/quitter", "kind": "unloaded"}
        if not replay.told(**quits):
            replay.until(**quits)
        assert replay.pids().items() >= before.items()
        assert len({before[name] for name in (*NAMES, "/quitting")}) == 1
        replay.process.send_signal(signal.SIGTERM)
        replay.read_all()
    assert not replay.told(event="process", kind="restarting")


def test_nothing_outlives_a_supervisor_that_is_killed(tmp_path: Path) -> None:
    with replaying(system(tmp_path), tmp_path / "logs") as replay:
        up(replay, *ALL)
        family = replay.descendants()
        assert len(family) > len(NODES)
        replay.process.kill()
        replay.process.wait(timeout=60)
        until(lambda: not alive(family), "the end of everything")


def test_its_nodes_have_groups_of_their_containers(tmp_path: Path) -> None:
    with control_group() as base:
        groups = {"base_path": str(base), "enabled": True}
        config = system(tmp_path, loading={"cgroups": groups})
        with replaying(config, tmp_path / "logs") as replay:
            pids = up(replay, *ALL)
            inside = [group_of(pids[name]).split("/")[-2:] for name in NODES]
            assert len({folder for folder, _ in inside}) == len(NODES)
            assert not {group_of(pids["/left"])} & {group_of(pids[name]) for name in NODES}
            replay.ask("restart", "/left", code=0)
            replay.read_until_up("/talker")
            after = replay.pids()
            assert {name for name in ALL if after[name] != pids[name]} == {"/talker"}
            replay.process.send_signal(signal.SIGTERM)
            replay.read_all()
        assert not [each for each in base.iterdir() if each.is_dir()]


def test_the_example_of_the_page_is_what_it_says(tmp_path: Path) -> None:
    page = (Path(__file__).resolve().parents[2] / "docs" / "isolation.md").read_text("utf-8")
    (example,) = re.findall(r"```yaml\n(.*?)```\n", page, re.DOTALL)
    config = tmp_path / "robot.yaml"
    config.write_text(example, "utf-8")
    with replaying(config, tmp_path / "logs") as replay:
        pids = up(replay, "/camera", "/detector", "/guard")
        assert pids["/sensing"] == pids["/perception"] != pids["/safety"]
        config.write_text(example.replace("consolidate: true", "consolidate: false"), "utf-8")
        replay.ask("apply", config, code=0)
        apart = replay.pids()
        assert len({apart[name] for name in ("/sensing", "/perception", "/safety")}) == 3
        assert apart["/safety"] == pids["/safety"]
        config.write_text(example, "utf-8")
        replay.ask("apply", config, code=0)
        pids = replay.pids()
        assert pids["/sensing"] == pids["/perception"] != apart["/perception"]
        replay.process.send_signal(signal.SIGTERM)
        replay.read_all()


def test_the_preview_says_what_shares_a_process_and_why_something_does_not(tmp_path: Path) -> None:
    last = container("last", node("a"), on_exit="shutdown")
    unlike = container("unlike", node("b"), environment={"COLOUR": "red"})
    config = system(tmp_path, last, unlike)
    found = json.loads(run("check", "--explain", "--json", config, code=0).stdout)["processes"]
    by_name = {each["name"]: each for each in found}
    assert by_name["/left"]["shares_process_with"] == ["/far/right", "/third"]
    assert by_name["/unlike"]["shares_process_with"] == []
    assert "on_exit: shutdown" in by_name["/last"]["alone"]
    text = run("check", "--explain", config, code=0).stdout
    assert "has one process with /left, /far/right (consolidate)" in text
    assert "has a process of its own in spite of consolidate" in text


def test_a_process_has_so_many_nodes_and_the_next_containers_get_the_next(tmp_path: Path) -> None:
    sizes = {"a": 30, "b": 30, "c": 30, "d": 70, "e": 4}
    containers = [
        container(name, *(node(f"{name}{i}") for i in range(size))) for name, size in sizes.items()
    ]
    loading = {"container_type": "isolated", "consolidate": True}
    config = written(tmp_path, containers=containers, composable_node_loading=loading)
    found = json.loads(run("check", "--explain", "--json", config, code=0).stdout)["processes"]
    shared = {each["name"]: each["shares_process_with"] for each in found if each["name"]}
    assert shared == {"/a": ["/b"], "/b": ["/a"], "/c": [], "/d": [], "/e": []}
