"""Containers that are not play-launch's own."""

from __future__ import annotations

import json
from pathlib import Path

from play_launch.config.description import describe
from play_launch.config.load import parse_config
from play_launch.config.model import ContainerConfig, ContainerType

TEXT = b"""
version: 1
composable_node_loading:
  container_type: stock
containers:
  - name: default
  - name: threads
    executable: component_container_isolated
    arguments: [--use_multi_threaded_executor]
    ros_arguments: [-p, "thread_num:=4"]
  - name: other
    package: my_containers
    executable: special
  - name: theirs
    namespace: /robot
    attach: true
  - name: ours
    container_type: standard
"""


def containers() -> dict[str, ContainerConfig]:
    parsed = parse_config(TEXT, Path("demo.yaml")).containers
    return {container.name: container for container in parsed}


def programs() -> dict[str, tuple[str, str]]:
    return {name: (each.package, each.executable) for name, each in containers().items()}


def test_the_program_is_rclcpps_unless_another_is_named() -> None:
    assert programs() == {
        "default": ("rclcpp_components", "component_container"),
        "threads": ("rclcpp_components", "component_container_isolated"),
        "other": ("my_containers", "special"),
        "theirs": ("", ""),
        "ours": ("", ""),
    }
    assert containers()["threads"].arguments == ("--use_multi_threaded_executor",)


def test_attaching_is_for_the_container_that_says_so() -> None:
    assert [name for name, each in containers().items() if each.attach] == ["theirs"]
    assert containers()["theirs"].full_name == "/robot/theirs"


def test_a_stock_container_is_neither_isolated_nor_one_with_threads_of_ours() -> None:
    assert not ContainerType.STOCK.is_isolated
    assert not ContainerType.STOCK.is_multi_threaded


def test_the_description_tells_it() -> None:
    described = json.loads(json.dumps(describe(parse_config(TEXT, Path("demo.yaml")))))
    default, threads, *_, theirs, _ = described["containers"]
    assert default["container_type"] == "stock"
    assert (default["package"], default["executable"], default["attach"]) == (
        "rclcpp_components",
        "component_container",
        False,
    )
    assert threads["arguments"] == ["--use_multi_threaded_executor"]
    assert theirs["attach"] is True
