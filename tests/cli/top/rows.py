"""Rows to try things on."""

from __future__ import annotations

from typing import Any

from play_launch.cli.top.model import Row
from play_launch.supervisor.events import ContainerState, NodeState

STATES = sorted(
    {state.value for state in (*ContainerState, *NodeState)} | {"exited", "waiting", "unheard of"}
)


def row(name: str, state: str = "running", kind: str = "container", **fields: Any) -> Row:
    return Row(name=name, kind=kind, state=state, **fields)


def node(name: str, container: str, state: str = "loaded", **fields: Any) -> Row:
    return row(name, state, "component", container=container, **fields)
