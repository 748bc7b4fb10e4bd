"""Views and events for the tests of what is shown."""

from __future__ import annotations

from play_launch.config.node_key import NodeKey
from play_launch.supervisor.events import (
    ContainerState,
    ContainerStateChanged,
    NodeState,
    NodeStateChanged,
    OutputLine,
    ProcessEvent,
    ProcessEventKind,
    RunEvent,
    Stream,
)
from play_launch.supervisor.view import SystemView

SECOND = 1_000_000_000
START = 1_700_000_000 * SECOND


def container(
    name: str, state: ContainerState = ContainerState.RUNNING, *, reason: str = "", at: float = 0
) -> ContainerStateChanged:
    stamp_ns = START + round(at * SECOND)
    return ContainerStateChanged(stamp_ns=stamp_ns, container=name, state=state, reason=reason)


def node(
    owner: str,
    index: int,
    state: NodeState,
    *,
    at: float = 0,
    elapsed: float = 0,
    reason: str = "",
    pid: int = 0,
    crashes: int = 0,
    reloads: int = 0,
) -> NodeStateChanged:
    return NodeStateChanged(
        stamp_ns=START + round(at * SECOND),
        key=NodeKey(owner, f"{owner}/n{index}"),
        state=state,
        elapsed_ns=round(elapsed * SECOND),
        reason=reason,
        pid=pid,
        crashes=crashes,
        reloads=reloads,
    )


def process(
    name: str,
    kind: ProcessEventKind,
    *,
    exit_code: int = 0,
    signal: int = 0,
    restarts: int = 0,
    message: str = "",
    pid: int = 77,
) -> ProcessEvent:
    return ProcessEvent(
        stamp_ns=START,
        kind=kind,
        name=name,
        pid=pid,
        exit_code=exit_code,
        signal=signal,
        restarts=restarts,
        message=message,
    )


def output(text: str, stream: Stream = Stream.STDOUT, source: str = "/a") -> OutputLine:
    return OutputLine(stamp_ns=START, process=source, pid=77, stream=stream, text=text)


def view(*events: RunEvent) -> SystemView:
    return folded_after(SystemView(), *events)


def folded_after(folded: SystemView, *events: RunEvent) -> SystemView:
    for event in events:
        folded = folded.after(event)
    return folded
