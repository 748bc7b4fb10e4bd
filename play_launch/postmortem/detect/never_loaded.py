"""Units that never came up, and of which no failure is recorded."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from play_launch.postmortem.declared import DeclaredPlace
from play_launch.postmortem.findings import Finding
from play_launch.supervisor.events import ContainerState, NodeState, ProcessEventKind

if TYPE_CHECKING:
    from collections.abc import Iterator

    from play_launch.postmortem.timeline import Timeline

_MISSING: Final = frozenset(
    {NodeState.PENDING, NodeState.REQUESTED, NodeState.LOADING, NodeState.LOST}
)

_GAVE_UP: Final = frozenset({ContainerState.GAVE_UP, ProcessEventKind.GAVE_UP})


def detect(timeline: Timeline) -> Iterator[Finding]:
    failed = {each.key for each in timeline.failures}
    for unit in timeline.units:
        state = unit.state
        if unit.failure or unit.key in failed or unit.is_withdrawn:
            continue
        if state in _GAVE_UP and unit.changes:
            yield Finding(
                kind="not_started",
                rank=0,
                says="was not started: it was given up {when}",
                who=unit.name,
                key=unit.key,
                times_ns=(unit.changes[-1][0],),
                cause=unit.reason,
            )
        if state not in _MISSING:
            continue
        what = "not loaded again" if state is NodeState.LOST else "never loaded"
        yield Finding(
            kind="not_loaded",
            rank=2,
            says=f"was {what}: it was {state} since {{at}}",
            who=unit.name,
            key=unit.key,
            times_ns=(unit.since_ns,),
            cause=unit.reason,
            place=DeclaredPlace(container=unit.container),
            state=str(state),
            since_ns=unit.since_ns,
            last_lines=timeline.last_lines(unit),
        )
