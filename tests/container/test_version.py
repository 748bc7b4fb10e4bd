"""What the program says of itself, for people and for `play-launch doctor`."""

from __future__ import annotations

import os
import re
import subprocess

from play_launch.container.environment import child_environment
from play_launch.container.ros import component_container, ros_installation


def test_version_and_kinds_of_components() -> None:
    done = subprocess.run(
        [component_container(), "--version"],
        env=child_environment(os.environ, ros_installation()),
        capture_output=True,
        text=True,
        check=True,
    )
    assert re.fullmatch(
        r"component_container \d+\.\d+\.\d+, components: native( rclcpp)?\n", done.stdout
    )
    assert done.stderr == ""
