"""Small systems that several tests bring up, and what configurations are made of."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Final

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


def node(name: str, plugin: str = "Talker", **more: Any) -> dict[str, Any]:
    """A composable node of the demo's components."""
    package = "play_launch_demo"
    return {"package": package, "plugin": f"{package}::{plugin}", "name": name, **more}


def container(name: str, *nodes: dict[str, Any], **more: Any) -> dict[str, Any]:
    return {"name": name, "composable_nodes": list(nodes), **more}


def ending(file: Path) -> dict[str, Any]:
    """A process that ends its system in order when that file is there."""
    waiting = f"until [ -e {file} ]; do sleep 0.1; done"
    return {"name": "end", "command": ["sh", "-c", waiting], "on_exit": "shutdown"}


def written(path: Path, **keys: Any) -> Path:
    """Write a configuration; a folder gets it as ``robot.yaml``."""
    path = path / "robot.yaml" if path.is_dir() else path
    # YAML holds JSON.
    path.write_text(json.dumps({"version": 1, **keys}), encoding="utf-8")
    return path
