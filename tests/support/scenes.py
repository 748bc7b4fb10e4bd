"""Small systems that several tests bring up."""

from __future__ import annotations

from typing import Final

TALKER_AND_SLEEPER: Final = """
version: 1
name: robot
containers:
  - name: chat
    composable_nodes:
      - {package: play_launch_demo, plugin: "play_launch_demo::Talker", name: talker}
nodes:
  - {name: sleeper, command: [sleep, "1000"]}
"""
"""A member of each kind."""
