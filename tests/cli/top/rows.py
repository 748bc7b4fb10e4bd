"""Rows to try things on."""

from __future__ import annotations

from typing import Any

from play_launch.cli.top.model import TopRow
from play_launch.supervisor.events import ContainerState, NodeState

STATES = sorted(
    {state.value for state in (*ContainerState, *NodeState)} | {"exited", "waiting", "unheard of"}
)


NOTHING: dict[str, Any] = {
    **dict.fromkeys(("container", "managed", "pid", "uptime_s", "exit_code", "signal")),
    **dict.fromkeys(("cpu_percent", "memory_bytes", "memory_kind")),
    "reason": "",
    "restarts": 0,
    "crashes": 0,
}


def row(name: str, state: str = "running", kind: Any = "container", **fields: Any) -> TopRow:
    return TopRow(**{**NOTHING, "name": name, "kind": kind, "state": state, **fields})


def node(name: str, container: str, state: str = "loaded", **fields: Any) -> TopRow:
    return row(name, state, "component", container=container, **fields)
