"""Rows to try things on."""

from __future__ import annotations

from typing import Any

from play_launch.control.messages import UnitRow
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


def row(name: str, state: str = "running", kind: Any = "container", **fields: Any) -> UnitRow:
    return UnitRow(**{**NOTHING, "name": name, "kind": kind, "state": state, **fields})


def node(name: str, container: str, state: str = "loaded", **fields: Any) -> UnitRow:
    return row(name, state, "component", container=container, **fields)
