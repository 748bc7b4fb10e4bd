"""Systems of one container, as benchmarks run them with the supervisor's own parts."""

from __future__ import annotations

import json
import os
import resource
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from msgspec.structs import replace

from play_launch.config.load import parse_config
from play_launch.config.model import ReplayConfig

CONTAINER = "/lab"
_PACKAGE = "play_launch_demo"
# Brought back at once, however often: a life of a millisecond is a healthy one.
_RESTART = {
    "max_restarts": 1_000_000,
    "within": "1 ms",
    "backoff": {"initial": "1 us", "maximum": "1 us"},
}
_CONTAINER_RESTART = {**_RESTART, "backoff": {"initial": "100 ms", "maximum": "100 ms"}}


@dataclass(frozen=True, slots=True)
class Node:
    """A component of play_launch_demo; `by_pointer`: use_intra_process_comms.

    `resources` are as in a configuration.
    """

    name: str
    plugin: str
    parameters: Mapping[str, object] = field(default_factory=dict)
    by_pointer: bool = True
    resources: Mapping[str, object] = field(default_factory=dict)


def system(
    mode: str,
    nodes: Sequence[Node],
    *,
    environment: Mapping[str, str],
    isolation: str = "",
    arguments: tuple[str, ...] = (),
) -> ReplayConfig:
    """A configuration with one container of that mode; JSON is YAML, too.

    `arguments` of the container are not for a file.
    """
    composable = [
        {
            "package": _PACKAGE,
            "plugin": f"{_PACKAGE}::{node.plugin}",
            "name": node.name,
            "log_level": "warn",
            "parameters": dict(node.parameters),
            "extra_arguments": {"use_intra_process_comms": node.by_pointer},
        }
        | ({"restart": _RESTART} if mode.startswith("isolated") else {})
        | ({"resources": dict(node.resources)} if node.resources else {})
        for node in nodes
    ]
    container: dict[str, object] = {
        "name": CONTAINER.removeprefix("/"),
        "container_type": mode,
        "environment": dict(environment),
        "restart": _CONTAINER_RESTART,
        "composable_nodes": composable,
    }
    if isolation:
        container["isolation"] = isolation
    text = json.dumps({"version": 1, "containers": [container]})
    config = parse_config(text.encode(), Path("benchmark.yaml"))
    containers = tuple(replace(one, arguments=arguments) for one in config.containers)
    return replace(config, containers=containers)


def keep_to_this_machine() -> None:
    """Loopback only, a domain of its own, and no core dumps: there would be thousands."""
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    os.environ.setdefault("ROS_DOMAIN_ID", "97")
    _, hard = resource.getrlimit(resource.RLIMIT_CORE)
    resource.setrlimit(resource.RLIMIT_CORE, (0, hard))
