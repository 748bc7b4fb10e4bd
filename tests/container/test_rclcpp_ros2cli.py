"""An unmodified `ros2 component` against our container: the steps of upstream's tutorial."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from std_msgs.msg import String

from play_launch.ros.fastdds.shared_memory import sweep
from tests.support.control_peer import TIMEOUT, StartContainer
from tests.support.isolated import ALL_MODES, start
from tests.support.ros import Probe

pytestmark = pytest.mark.needs_packages("ros2component", "composition")


UNSEEN = "Unable to find container node"
"""The command looks at the graph once, and may be earlier than discovery is."""


def run_ros2(*arguments: str) -> subprocess.CompletedProcess[str]:
    program = shutil.which("ros2")
    assert program is not None, "ros2 is not in PATH"
    deadline = time.monotonic() + TIMEOUT
    while True:
        done = subprocess.run(
            [program, *arguments], capture_output=True, text=True, timeout=120, check=False
        )
        if UNSEEN not in done.stderr or time.monotonic() > deadline:
            return done


def ros2(*arguments: str) -> str:
    """What the command prints; it must succeed."""
    done = run_ros2(*arguments)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(autouse=True)
def _no_daemon() -> Iterator[None]:
    """The commands start a daemon, which would outlive the tests, and leave shared memory."""
    yield
    ros2("daemon", "stop")
    sweep()


def test_types(spawn: StartContainer) -> None:
    start(spawn, "standard")
    types = ros2("component", "types").splitlines()
    assert "composition" in types
    assert "  composition::Talker" in types


@pytest.mark.parametrize("mode", ALL_MODES)
def test_list_load_unload(spawn: StartContainer, mode: str, probe: Probe) -> None:
    container = start(spawn, mode)
    deadline = time.monotonic() + TIMEOUT
    while ros2("component", "list").split() != ["/container"]:
        assert time.monotonic() < deadline, "the container is not in the list"
    load = ("component", "load", "/container", "composition")
    assert ros2(*load, "composition::Talker") == (
        "Loaded component 1 into '/container' container node as '/talker'\n"
    )
    loaded = ros2(
        *load,
        "composition::Listener",
        *("--node-name", "ear", "--node-namespace", "/head", "-r", "chatter:=/chatter"),
        *("-e", "use_intra_process_comms:=true", "-p", "use_sim_time:=false"),
    )
    assert "'/head/ear'" in loaded
    probe.collect(String, "/chatter", 1, timeout=60.0)
    probe.spin_until(
        lambda: "[head.ear]: I heard: [Hello World" in container.log.read_text(), 30.0, "the ear"
    )
    assert ros2("component", "list", "/container").split() == ["1", "/talker", "2", "/head/ear"]
    assert ros2("component", "unload", "/container", "1", "2").count("Unloaded component") == 2
    assert ros2("component", "list", "/container").split() == []
    assert container.shut_down() == 0, container.log.read_text()


def test_what_cannot_be_loaded_is_told(spawn: StartContainer) -> None:
    start(spawn, "standard")
    done = run_ros2("component", "load", "/container", "composition", "composition::Absent")
    assert done.returncode != 0
    assert "has no component 'composition::absent'" in done.stderr.lower()


@pytest.mark.needs_packages("ros2run", "ros2interface")
def test_after_the_line_of_the_doctor_it_finds_our_container_and_messages() -> None:
    doctor = [os.fspath(Path(sys.executable).with_name("play-launch")), "doctor", "--json"]
    said = subprocess.run(doctor, capture_output=True, text=True, timeout=120, check=False)
    findings = {each["subject"]: each["says"] for each in json.loads(said.stdout)["findings"]}
    line = findings["ros2 command"].partition(": ")[2]
    code = (
        "import rclpy.serialization as s; from play_launch_msgs.msg import ComponentEvent as E; "
        "print(s.deserialize_message(s.serialize_message(E(pid=7)), E).pid)"
    )
    commands = [
        line,
        "ros2 run play_launch_container component_container --version",
        "ros2 interface show play_launch_msgs/msg/ComponentEvent",
        f"python3 -c '{code}'",
    ]
    shell = ["bash", "-e", "-c", "\n".join(commands)]
    done = subprocess.run(shell, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("component_container ")
    assert done.stdout.endswith("\n7\n")


@pytest.mark.needs_packages("ros2launch", "launch_ros")
def test_a_launch_file(spawn: StartContainer, tmp_path: os.PathLike[str], probe: Probe) -> None:
    container = start(spawn, "isolated")
    path = os.path.join(tmp_path, "load_launch.py")  # noqa: PTH118
    with open(path, "w") as file:  # noqa: PTH123
        file.write(
            """
from launch import LaunchDescription
from launch_ros.actions import LoadComposableNodes
from launch_ros.descriptions import ComposableNode


def generate_launch_description():
    return LaunchDescription([
        LoadComposableNodes(
            target_container="/container",
            composable_node_descriptions=[
                ComposableNode(
                    package="composition", plugin="composition::Talker", name="talker",
                    extra_arguments=[{"use_intra_process_comms": True}]),
                ComposableNode(
                    package="composition", plugin="composition::Listener", name="listener",
                    parameters=[{"one": 1}], remappings=[("chatter", "/chatter")]),
            ],
        ),
    ])
"""
        )
    ros2("launch", path)
    assert set(ros2("component", "list", "/container").split()[1::2]) == {"/talker", "/listener"}
    probe.collect(String, "/chatter", 1, timeout=60.0)
    assert container.shut_down() == 0, container.log.read_text()
