"""A small system of the project's own components, as a launch file with two includes."""

from __future__ import annotations

from pathlib import Path

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


def write(folder: Path) -> Path:
    """Write the files; return the launch file."""
    for name, text in FILES.items():
        (folder / name).write_text(text.lstrip("\n"), encoding="utf-8")
    return folder / "robot.launch.xml"
