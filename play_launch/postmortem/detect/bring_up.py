"""Units that never came up and failed in no way, and a node for which the whole system waited."""

from __future__ import annotations

from statistics import median
from typing import TYPE_CHECKING, Final

from msgspec.structs import replace

from play_launch.config.text import duration
from play_launch.postmortem.critical_chain import critical_chain, left_behind, nodes_of_bring_up
from play_launch.postmortem.findings import DeclaredPlace, Finding
from play_launch.supervisor.events import ContainerState, NodeState, ProcessEventKind, SubjectKind

if TYPE_CHECKING:
    from collections.abc import Iterator

    from play_launch.postmortem.timeline import Timeline
    from play_launch.postmortem.units import Unit

_MISSING: Final = frozenset(
    {NodeState.PENDING, NodeState.REQUESTED, NodeState.LOADING, NodeState.LOST}
)
_GAVE_UP: Final = frozenset({ContainerState.GAVE_UP, ProcessEventKind.GAVE_UP})
_LEAST_NODES: Final = 3
_LATER: Final = 5_000_000_000
"""Nanoseconds after all others, at least."""
_FACTOR: Final = 2
"""Times as late as the median."""


def detect(timeline: Timeline) -> Iterator[Finding]:
    yield from _missing(timeline)
    yield from _late(timeline)


def _missing(timeline: Timeline) -> Iterator[Finding]:
    failed = {each.key for each in timeline.failures}
    dismissed = {each.key for each in timeline.units if each.is_dismissed}
    units = [
        unit
        for unit in timeline.units
        if not (unit.is_withdrawn or unit.failure or unit.key in failed)
        and dismissed.isdisjoint({unit.key, unit.container})
    ]
    behind = left_behind(timeline)
    absent = {unit.key: found for unit in units if (found := _absence(timeline, unit))}
    for unit in units:
        has_cause = unit.container in failed or unit.container in absent
        if unit.key not in absent or (has_cause and unit.name in behind.get(unit.container, ())):
            continue
        yield replace(
            absent[unit.key],
            name=unit.name,
            key=unit.key,
            place=DeclaredPlace(container=unit.container),
            last_lines=timeline.lines.of_life(unit, unit.since_ns),
            hit=tuple(behind.get(unit.key, ())),
        )


def _absence(timeline: Timeline, unit: Unit) -> Finding | None:
    """Say how a unit was missing that did not fail; None: it was not."""
    state, reason = unit.state, unit.reason
    if state in _GAVE_UP and unit.changes:
        again, at_ns = " again" if unit.begun_ns else "", unit.changes[-1][0]
        says = f"was not started{again}: it was given up {{when}}"
        return Finding(kind="not_started", rank=0, says=says, times_ns=(at_ns,), cause=reason)
    if unit.kind is not SubjectKind.NODE and unit.waited and not unit.begun_ns and unit.changes:
        says, at_ns = "was not started: it waited, from {at} to the end", unit.changes[0][0]
        return Finding(kind="not_started", rank=2, says=says, times_ns=(at_ns,), cause=unit.waited)
    if unit.kind is SubjectKind.CONTAINER and unit.begun_ns and not unit.ready_ns:
        says, at_ns = "was never ready: it was starting since {at}", unit.begun_ns
        return Finding(kind="not_started", rank=2, says=says, times_ns=(at_ns,))
    # With its container, it did not leave alone.
    if unit.left_ns and timeline.of_name(unit.container).failure is None:
        says = "was unloaded {when}, by another program or itself, and not loaded again"
        return Finding(kind="left", rank=2, says=says, times_ns=(unit.left_ns,), cause=reason)
    if state not in _MISSING:
        return None
    since_ns, container = unit.since_ns, timeline.of_name(unit.container)
    if state is NodeState.LOST and container.is_stopping and len(unit.changes) > 1:
        since_ns, state, _ = unit.changes[-2]  # what it was before the stop counts
        reason = ""
        if state not in _MISSING:
            return None
    what = "not loaded again" if state is NodeState.LOST else "never loaded"
    return Finding(
        kind="not_loaded",
        rank=2,
        says=f"was {what}: it was {state} since {{at}}",
        times_ns=(since_ns,),
        cause=reason,
        state=str(state),
        since_ns=since_ns,
    )


def _late(timeline: Timeline) -> Iterator[Finding]:
    started = timeline.session.started_ns
    nodes = nodes_of_bring_up(timeline)
    arrived = sorted((unit for unit in nodes if unit.arrival), key=lambda unit: unit.ready_ns)
    if len(arrived) < max(_LEAST_NODES, len(nodes)):
        return  # a node that never came is a finding of its own
    *others, last = arrived
    usual = median(unit.ready_ns - started for unit in others)
    later = last.ready_ns - others[-1].ready_ns
    if later < _LATER or last.ready_ns - started < _FACTOR * usual:
        return
    if last.arrival is not NodeState.LOADED:
        return
    chain = critical_chain(timeline, last)
    steps = [(step.ns, f"{link.name}: {step}") for link in chain for step in link.steps]
    yield Finding(
        kind="late_bring_up",
        rank=6,
        is_failure=False,
        says=f"was loaded last, {duration(later)} after all other nodes, {{at}}",
        name=last.name,
        key=last.key,
        times_ns=(last.ready_ns,),
        cause=max(steps, default=(0, ""))[1],
        chain=tuple(link.text(started) for link in chain),
        place=DeclaredPlace(container=last.container),
    )
