"""Makes this process speak ROS as a session does: same domain, middleware and discovery."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from play_launch.control.client import ControlClient


def enter_environment_of(client: ControlClient) -> None:
    """Set what the session says about ROS; before anything of rclpy is imported."""
    found = client.ask("environment")
    for name in [name for name in os.environ if name.startswith(("ROS_", "RMW_"))]:
        if name not in found:
            del os.environ[name]
    os.environ.update({str(name): str(value) for name, value in found.items()})
