"""What ``play-launch replay session.mcap`` starts, and what differs from when it was recorded."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from play_launch.cli.output import warn
from play_launch.config.substitutions import share_folder
from play_launch.control.protocol import ROS_VARIABLES
from play_launch.postmortem.recorded_config import RecordedConfig, recorded_config
from play_launch.recording.environment import REDACTED, versions
from play_launch.recording.resolved_form import resolved_form

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from play_launch.config.model import ReplayConfig

_VERSIONS: Final = ("play-launch-py", "ros-rclpy", "rclpy")
_MOST: Final = 20
"""Differences that are listed."""


def load_recorded(path: Path, arguments: Mapping[str, str] | None = None) -> ReplayConfig:
    """Read the configuration of a recording, and report what differs here.

    Raises ConfigError when it holds none, or one that this version does not accept.
    """
    recorded = recorded_config(path, arguments)
    found = list(differences(recorded, os.environ, versions()))
    for text in found[:_MOST]:
        warn(text)
    if len(found) > _MOST:
        warn(f"{len(found) - _MOST} more differences")
    return recorded.config


def differences(
    recorded: RecordedConfig, environ: Mapping[str, str], here: Mapping[str, str]
) -> Iterator[str]:
    then = _versions(recorded.about)
    for name in _VERSIONS:
        if then.get(name, "") != here.get(name, ""):
            versions_of = [each.get(name) or "none" for each in (then, here)]
            yield f"{name}: recorded with {versions_of[0]}, here is {versions_of[1]}"
    for package in sorted(_packages(recorded.config)):
        if share_folder(package, environ) is None:
            yield f"package {package} is not installed here"
    names = {*recorded.environment, *environ}
    for name in sorted(name for name in names if name.startswith(ROS_VARIABLES)):
        was, now = recorded.environment.get(name), environ.get(name)
        if was not in {now, REDACTED}:
            yield f"{name} was {_quoted(was)}, here it is {_quoted(now)}"
    yield from _differing("", recorded.resolved, resolved_form(recorded.config))


def _differing(path: str, then: Any, now: Any) -> Iterator[str]:
    """Compare two resolved configurations; keys that only one of them has are new or gone."""
    if isinstance(then, dict) and isinstance(now, dict):
        for key in then.keys() & now.keys():
            yield from _differing(f"{path}.{key}" if path else key, then[key], now[key])
    elif isinstance(then, list) and isinstance(now, list) and len(then) == len(now):
        for number, (one, other) in enumerate(zip(then, now, strict=True)):
            yield from _differing(f"{path}[{number}]", one, other)
    elif then != json.loads(json.dumps(now)):  # as JSON gives it back
        yield f"{path} was {json.dumps(then)[:80]}, here it is {json.dumps(now)[:80]}"


def _versions(about: Mapping[str, str]) -> dict[str, str]:
    try:
        values = json.loads(about.get("versions", ""))
    except ValueError:
        return {}
    return values if isinstance(values, dict) else {}


def _packages(config: ReplayConfig) -> set[str]:
    found = {node.package for each in config.containers for node in each.composable_nodes}
    found |= {node.package for node in config.nodes if node.package}
    return found


def _quoted(value: str | None) -> str:
    return "not set" if value is None else f"'{value}'"
