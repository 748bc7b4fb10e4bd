"""Rows to try things on."""

from __future__ import annotations

from typing import Any

from play_launch.cli.top.model import TopRow
from play_launch.supervisor.events import ContainerState, NodeState

STATES = sorted(
    {state.value for state in (*ContainerState, *NodeState)} | {"exited", "waiting", "unheard of"}
)


def row(name: str, state: str = "running", kind: str = "container", **fields: Any) -> TopRow:
    return TopRow(name=name, kind=kind, state=state, **fields)


def node(name: str, container: str, state: str = "loaded", **fields: Any) -> TopRow:
    return row(name, state, "component", container=container, **fields)
