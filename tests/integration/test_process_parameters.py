"""Nodes that a process or a container makes itself get their parameters, from a launch file on."""

from __future__ import annotations

import json
import os
import shutil
import sys
from pathlib import Path

import pytest

from play_launch.launch_files.configuration.options import Options
from play_launch.launch_files.configuration.write import written
from tests.launch_files.recorded import FOLDER, description
from tests.support.replay import replaying
from tests.support.waiting import until

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
    made = written(description("costmaps", tmp_path), Options(folder=tmp_path), "From x.")
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
