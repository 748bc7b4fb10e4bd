"""The same two nodes brought up by a launch file of ROS, in one container, as ROS has it.

It is run by launch itself, which is what `ros2 launch` does: that command need not be there.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import sys
import tempfile
from collections.abc import AsyncIterator, Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

from play_launch.container.environment import child_environment
from play_launch.container.ros import component_container, ros_installation

STOCK: Final = "launch file, one container"
_END_LIMIT: Final = 30.0
_PACKAGE: Final = "play_launch_demo"
_RUN: Final = """
import sys
from launch import LaunchDescription, LaunchService
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource

service = LaunchService()
file = PythonLaunchDescriptionSource(sys.argv[1])
service.include_launch_description(LaunchDescription([IncludeLaunchDescription(file)]))
sys.exit(service.run())
"""
# The greedy node first: when the other one beats, both are there.
_LAUNCH_FILE: Final = """
from launch import LaunchDescription
from launch.actions import ExecuteProcess
from launch_ros.actions import LoadComposableNodes
from launch_ros.descriptions import ComposableNode


def generate_launch_description():
    nodes = [
        ComposableNode(package={package!r}, plugin="{package}::" + plugin, name=name,
                       parameters=[parameters])
        for name, plugin, parameters in [
            ("greedy", "Greedy", {{"threads": 0}}), ("control", "ControlLoop", {control!r})]
    ]
    return LaunchDescription([
        ExecuteProcess(cmd=[{program!r}, "--use_multi_threaded_executor",
                            "--ros-args", "-r", "__node:=lab"]),
        LoadComposableNodes(target_container="/lab", composable_node_descriptions=nodes),
    ])
"""


def obstacle() -> str:
    """Why it cannot be measured here; empty: it can."""
    missing = [name for name in ("launch", "launch_ros") if find_spec(name) is None]
    return f"{' and '.join(missing)} cannot be imported here" if missing else ""


@contextlib.asynccontextmanager
async def launched(
    control: Mapping[str, Any], environment: Mapping[str, str]
) -> AsyncIterator[None]:
    """Have both run while the block does; they come up meanwhile."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "both_launch.py"
        text = _LAUNCH_FILE.format(
            package=_PACKAGE, control=dict(control), program=str(component_container())
        )
        file.write_text(text, encoding="utf-8")
        process = await asyncio.create_subprocess_exec(
            *(sys.executable, "-c", _RUN, str(file)),
            env=child_environment(os.environ, ros_installation(), environment),
            stdout=asyncio.subprocess.DEVNULL,
        )
        try:
            yield
        finally:
            if process.returncode is None:
                process.send_signal(signal.SIGINT)
            try:
                await asyncio.wait_for(process.wait(), _END_LIMIT)
            except TimeoutError:
                process.kill()
                await process.wait()
