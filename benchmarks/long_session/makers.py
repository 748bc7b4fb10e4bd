"""Events as the supervisor publishes them, at a time in seconds."""

from __future__ import annotations

from typing import Any

from benchmarks.long_session.plan import stamp
from play_launch.config.node_key import NodeKey
from play_launch.supervisor.events import (
    ComponentEvent,
    ComponentEventKind,
    ContainerState,
    ContainerStateChanged,
    LogRecord,
    NodeState,
    NodeStateChanged,
    ProcessEvent,
    ProcessEventKind,
)
from play_launch.supervisor.outcome import Cause

_NOTHING: dict[str, Any] = {"cause": Cause.NONE}
"""Of an event without a cause; one without the field is of the first version."""


def container_state(
    at: float, name: str, state: ContainerState, reason: str = "", **fields: Any
) -> ContainerStateChanged:
    mechanism = "shared_memory" if state is ContainerState.RUNNING else ""
    return ContainerStateChanged(
        stamp_ns=stamp(at),
        container=name,
        state=state,
        reason=reason,
        mechanism=mechanism,
        **(_NOTHING | fields),
    )


def node_state(
    at: float, key: NodeKey, state: NodeState, reason: str = "", **fields: Any
) -> NodeStateChanged:
    reloads = fields.get("crashes", 0)
    return NodeStateChanged(
        stamp_ns=stamp(at),
        key=key,
        state=state,
        reason=reason,
        reloads=reloads,
        **(_NOTHING | fields),
    )


def step(  # noqa: PLR0917 - in the order of the event
    at: float,
    name: str,
    kind: ProcessEventKind,
    pid: int,
    restarts: int,
    message: str = "",
    **fields: Any,
) -> ProcessEvent:
    return ProcessEvent(
        stamp_ns=stamp(at),
        kind=kind,
        name=name,
        pid=pid,
        restarts=restarts,
        message=message,
        **(_NOTHING | fields),
    )


def component(
    at: float, key: NodeKey, kind: ComponentEventKind, pid: int, attempt: int, **fields: Any
) -> ComponentEvent:
    area, role = key.name.split("/")[1:]
    return ComponentEvent(
        stamp_ns=stamp(at),
        kind=kind,
        container=key.container,
        unique_id=attempt,
        attempt=attempt,
        full_node_name=key.name,
        package_name=f"{area}_nodes",
        plugin_name=f"{area}::{role.title()}",
        pid=pid,
        **fields,
    )


def log(at: float, level: int, message: str) -> LogRecord:
    name = "play_launch.actors.container.node_reports"
    return LogRecord(
        stamp_ns=stamp(at), level=level, name=name, message=message, file="node_reports.py", line=1
    )
