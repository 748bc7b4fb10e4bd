"""A small system of the project's own components, as a launch file with two includes."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

FILES = {
    "robot.launch.xml": """
<launch>
  <arg name="rate" default="20.0" description="messages per second"/>
  <arg name="with_tiny" default="true"/>
  <set_env name="ROBOT" value="small"/>
  <group>
    <push_ros_namespace namespace="robot"/>
    <node_container pkg="rclcpp_components" exec="component_container" name="box" namespace="">
      <composable_node pkg="play_launch_demo" plugin="play_launch_demo::Talker" name="talker">
        <param from="$(dirname)/params.yaml"/>
        <param name="rate" value="$(var rate)"/>
        <remap from="chatter" to="/words"/>
      </composable_node>
    </node_container>
  </group>
  <include file="$(dirname)/more.launch.yaml">
    <arg name="container" value="/robot/box"/>
  </include>
  <node pkg="play_launch_demo" exec="tiny_node" name="tiny" if="$(var with_tiny)"/>
</launch>
""",
    "more.launch.yaml": """
launch:
- arg: {name: container}
- load_composable_node:
    target: $(var container)
    composable_node:
    - pkg: play_launch_demo
      plugin: play_launch_demo::Listener
      name: listener
      remap:
      - {from: chatter, to: /words}
- timer:
    period: 0.1
    children:
    - executable: {cmd: sleep 100, name: sleeper}
""",
    "params.yaml": """
/**: {ros__parameters: {rate: 1.0, prefix: from the file}}
/other: {ros__parameters: {rate: 2.0}}
""",
}
NODES = {"/robot/talker": "loaded", "/listener": "loaded"}


def add_containers(prefix: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Add a made-up rclcpp_components for ROS's launch, behind what is installed.

    launch_ros looks for the program of a container, which a configuration does not need.
    """
    index = prefix / "share/ament_index/resource_index/packages"
    programs = prefix / "lib/rclcpp_components"
    for folder in (index, programs, prefix / "share/rclcpp_components"):
        folder.mkdir(parents=True)
    (index / "rclcpp_components").touch()
    (programs / "component_container").write_text("#!/bin/sh\n", encoding="utf-8")
    (programs / "component_container").chmod(0o755)
    paths = [*filter(None, [os.environ.get("AMENT_PREFIX_PATH")]), str(prefix)]
    monkeypatch.setenv("AMENT_PREFIX_PATH", os.pathsep.join(paths))


def write(folder: Path) -> Path:
    """Write the files; return the launch file."""
    for name, text in FILES.items():
        (folder / name).write_text(text.lstrip("\n"), encoding="utf-8")
    return folder / "robot.launch.xml"
