"""Ordinary nodes, run as a user runs them: prefix, directory, terminal, output, parameters, end."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import sys
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

import psutil
import pytest

from play_launch.launch_files.configuration import write as made_from
from play_launch.launch_files.configuration.request import Options
from tests.launch_files.recorded import FOLDER, description
from tests.support.replay import Replay, alive, recorded, replaying, run
from tests.support.scenes import container, node, written
from tests.support.slow_programs import slow_to_execute
from tests.support.waiting import until

FACTS = """
import os, sys
print("cwd", os.getcwd())
print("mark", os.environ.get("MARK"))
print("tty", os.isatty(0), os.isatty(1), os.isatty(2))
print("stdin", repr(sys.stdin.read()))
"""


def write(folder: Path, nodes: list[dict[str, Any]], **more: Any) -> Path:
    return written(folder, record={"ros": False}, nodes=nodes, **more)


def shown(replay: Replay, process: str) -> list[str]:
    return [event["text"] for event in replay.told(event="output", process=process)]


def in_recording(bag: Path, process: str) -> list[str]:
    return [each.msg for each in recorded(bag, "/play_launch/output") if each.name == process]


def facts(replay: Replay, process: str) -> dict[str, str]:
    return dict(text.split(" ", 1) for text in shown(replay, process))


def test_prefix_directory_and_terminal(tmp_path: Path) -> None:
    (tmp_path / "here").mkdir()
    command = [sys.executable, "-c", FACTS]
    nodes: list[dict[str, Any]] = [
        {"name": "plain", "command": command},
        {
            "name": "special",
            "command": command,
            "prefix": "env MARK='two words'",
            "cwd": "here",
            "emulate_tty": True,
        },
    ]
    with replaying(write(tmp_path, nodes), tmp_path / "logs") as replay:
        replay.read_all()
    assert replay.process.returncode == 0
    plain, special = facts(replay, "/plain"), facts(replay, "/special")
    assert plain["cwd"] == str(Path.cwd())
    assert plain["mark"] == "None"
    assert plain["tty"] == "False False False"
    assert special["cwd"] == str(tmp_path / "here")
    assert special["mark"] == "two words"
    assert special["tty"] == "False True True"
    assert plain["stdin"] == special["stdin"] == "''"


def test_a_missing_directory_is_named(tmp_path: Path) -> None:
    nodes = [{"name": "lost", "command": ["true"], "cwd": "nowhere"}]
    with replaying(write(tmp_path, nodes), tmp_path / "logs") as replay:
        replay.read_all()
    assert replay.process.returncode == 1
    (gave_up,) = (event for event in replay.seen if event.get("kind") == "gave_up")
    assert f"its working directory is no directory: {tmp_path}/nowhere" in gave_up["message"]


def test_one_mistake_keeps_all_the_rest_from_starting(tmp_path: Path) -> None:
    started = tmp_path / "started"
    bad = {"name": "bad", "comand": ["true"]}
    config = write(tmp_path, [{"name": "good", "command": ["touch", str(started)]}, bad])
    refused = run("replay", config, "--log-dir", tmp_path / "logs", code=2)
    assert re.search(r"robot\.yaml:1:\d+: nodes\[1\]", refused.stderr), refused.stderr
    assert "Traceback" not in refused.stderr
    assert not (tmp_path / "logs").exists()
    assert not started.exists()


@pytest.mark.parametrize("end", ["stopped meanwhile", "executed at last"])
def test_a_program_that_is_slow_to_execute_holds_nothing_up_and_starts_once(
    tmp_path: Path, end: str
) -> None:
    program = Path(shutil.copy(shutil.which("sleep") or "", tmp_path / "slow"))
    nodes: list[dict[str, Any]] = [
        {"name": "slow", "command": [str(program), "600"], "on_exit": "restart"},
        {"name": "quick", "command": ["echo", "here"]},
    ]
    with ExitStack() as leased:
        waits = leased.enter_context(slow_to_execute(program))
        with replaying(write(tmp_path, nodes), tmp_path / "logs") as replay:
            until(waits, "the execution")
            replay.until(event="output", process="/quick")
            if end == "executed at last":
                leased.close()
                until(lambda: runs(replay, program) > 0, "the program")
                assert runs(replay, program) == 1
            replay.process.send_signal(signal.SIGTERM)
            replay.read_all()
    assert replay.process.returncode == 128 + signal.SIGTERM
    kinds = [event["kind"] for event in replay.told(event="process", name="/slow")]
    assert kinds == ["started", "stopping", "exited"]


@pytest.mark.parametrize("state", ["gone", "not executable", "busy"])
def test_a_process_that_crashes_while_it_is_built_anew_is_started_again(
    tmp_path: Path, state: str
) -> None:
    sleep = shutil.which("sleep") or ""
    program = Path(shutil.copy(sleep, tmp_path / "built"))
    limits = {"max_restarts": 1000, "backoff": {"maximum": "100 ms"}}
    nodes = [
        {"name": "a", "command": [str(program), "600"], "on_exit": "restart", "restart": limits}
    ]
    with ExitStack() as building, replaying(write(tmp_path, nodes), tmp_path / "logs") as replay:
        first = replay.until(event="process", kind="started")
        if state == "gone":
            program.unlink()
        elif state == "not executable":
            program.chmod(0o644)
        else:  # one that runs cannot be written to
            program.unlink()
            building.callback(os.close, os.open(program, os.O_WRONLY | os.O_CREAT, 0o755))
        os.kill(first["pid"], signal.SIGSEGV)
        replay.until(event="process", kind="restarting", restarts=2)
        building.close()
        shutil.copy(sleep, program)
        until(lambda: runs(replay, program) > 0, "the program")
        replay.process.send_signal(signal.SIGTERM)
        replay.read_all()
    assert not replay.told(event="process", kind="gave up")


def runs(replay: Replay, program: Path) -> int:
    found = 0
    for each in replay.descendants():
        with suppress(psutil.Error):
            found += each.exe() == str(program)
    return found


def test_a_container_with_a_prefix_loads_its_nodes(tmp_path: Path) -> None:
    one = container("c", node("talker"), prefix="env MARK=set nice -n 5")
    config = write(tmp_path, [], containers=[one])
    with replaying(config, tmp_path / "logs") as replay:
        loaded = replay.until(event="node", state="loaded")
        environment = Path(f"/proc/{loaded['pid']}/environ").read_bytes().split(b"\0")
        assert b"MARK=set" in environment
        left = replay.descendants()
    assert not alive(left)


def test_output_goes_where_it_is_sent(tmp_path: Path) -> None:
    nodes = [
        {"name": where, "command": ["sh", "-c", "echo out; echo err >&2"], "output": where}
        for where in ("screen", "log", "both")
    ]
    with replaying(write(tmp_path, nodes), tmp_path / "logs") as replay:
        replay.read_all()
    everything = ["err", "out"]
    assert {where: sorted(shown(replay, f"/{where}")) for where in ("screen", "log", "both")} == {
        "screen": everything,
        "log": [],
        "both": everything,
    }
    assert {
        where: sorted(in_recording(replay.bag, f"/{where}")) for where in ("screen", "log")
    } == {
        "screen": [],
        "log": everything,
    }
    assert sorted(in_recording(replay.bag, "/both")) == everything


@pytest.mark.parametrize(("status", "code"), [(0, 0), (7, 1)])
def test_the_end_of_one_is_that_of_all(tmp_path: Path, status: int, code: int) -> None:
    nodes = [
        {"name": "other", "command": ["sleep", "600"]},
        {"name": "main", "command": ["sh", "-c", f"exit {status}"], "on_exit": "shutdown"},
    ]
    with replaying(write(tmp_path, nodes), tmp_path / "logs") as replay:
        replay.read_all()
    assert replay.process.returncode == code


SERVER = f"""#!{sys.executable}
import json, os, signal, sys
import rclpy
from rclpy.node import Node
rclpy.init()
options = dict(automatically_declare_parameters_from_overrides=True, start_parameter_services=False)
renamed = ["--ros-args", "-r", "__node:=costmap", "-r", "__ns:=/costmap"]
nodes = [Node("any", **options), Node("costmap", cli_args=renamed, **options)]
seen = {{
    node.get_fully_qualified_name(): {{
        name: node.get_parameter(name).value for name in node._parameters if "." not in name
    }}
    for node in nodes
}}
with open(sys.argv[1] + ".part", "w") as file:
    json.dump(seen, file)
os.rename(sys.argv[1] + ".part", sys.argv[1])
signal.pause()
"""


def test_costmaps_of_a_launch_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program = tmp_path / "prefix" / "lib" / "two_nodes" / "server"
    program.parent.mkdir(parents=True)
    program.write_text(SERVER, encoding="utf-8")
    program.chmod(0o755)
    index = tmp_path / "prefix/share/ament_index/resource_index/packages"
    index.mkdir(parents=True)
    (index / "two_nodes").touch()
    both = filter(None, [str(tmp_path / "prefix"), os.environ.get("AMENT_PREFIX_PATH")])
    monkeypatch.setenv("AMENT_PREFIX_PATH", os.pathsep.join(both))
    shutil.copy(FOLDER / "costmaps/p.yaml", tmp_path)
    made = made_from.written(description("costmaps", tmp_path), Options(folder=tmp_path), "From x.")
    robot = tmp_path / "robot.yaml"
    robot.write_text(made.text, encoding="utf-8")
    assert made.lost == 0
    assert robot.read_text(encoding="utf-8").count("p.yaml") == 3
    with replaying(robot, tmp_path / "log") as replay:
        replay.read_until_states({"/talker": "loaded"})
        until((tmp_path / "seen").exists, "what the nodes have got")
        seen = json.loads((tmp_path / "seen").read_text(encoding="utf-8"))
        for values in seen.values():
            for of_rclpy in ("use_sim_time", "start_type_description_service"):
                values.pop(of_rclpy, None)
        assert seen == {
            "/server": {"everywhere": True, "a": 1, "b": "own"},
            "/costmap/costmap": {"everywhere": True, "width": 3},
        }
        replay.until_operable()
        assert json.loads(replay.ask("param", "get", "/talker", "rate", "--json").stdout) == {
            "rate": 5.0
        }
        assert replay.ask("diff", robot).stdout == "nothing differs\n"
        changed = (tmp_path / "p.yaml").read_text(encoding="utf-8").replace("width: 3", "width: 4")
        (tmp_path / "p.yaml").write_text(changed, encoding="utf-8")
        shown = replay.ask("diff", robot, code=1).stdout
        assert "/server (process): restart" in shown
        assert "process_parameters./costmap/costmap.width.value: 3 -> 4" in shown
