"""Nodes that were never loaded, or not again, and nothing reports why."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from play_launch.postmortem.declared import Place
from play_launch.postmortem.findings import Finding
from play_launch.supervisor.events import NodeState

if TYPE_CHECKING:
    from collections.abc import Iterator

    from play_launch.postmortem.timeline import Timeline

_MISSING: Final = frozenset(
    {NodeState.PENDING, NodeState.REQUESTED, NodeState.LOADING, NodeState.LOST}
)


def detect(timeline: Timeline) -> Iterator[Finding]:
    failed = {each.key for each in timeline.failures}
    for unit in timeline.units:
        state = unit.state
        if state not in _MISSING or unit.failure or unit.key in failed or unit.is_withdrawn:
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
            place=Place(container=unit.container),
            state=str(state),
            since_ns=unit.since_ns,
            last_lines=timeline.last_lines(unit),
        )
