"""What the last node waited for, unit by unit, back to the start of the session."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from msgspec import Struct
from msgspec.structs import replace

from play_launch.config.dependency import Condition
from play_launch.config.text import duration
from play_launch.supervisor.events import NodeState, ProcessEventKind, SubjectKind

if TYPE_CHECKING:
    from collections.abc import Iterator

    from play_launch.postmortem.timeline import Timeline
    from play_launch.postmortem.units import Unit

_BRIEF: Final = 50_000_000
"""Nanoseconds that are not worth a word, or in which a unit begins after what it waited for."""
_NEVER: Final = 1 << 63
_RESULTS: Final = {
    Condition.STARTED: ("started", "not started yet"),
    Condition.LOADED: ("loaded", "not loaded yet"),
    Condition.ACTIVE: ("active", "not active yet"),
    Condition.EXITED: ("exited", "still running"),
    Condition.LOG: ("wrote the line", "has not written the line"),
}
"""Of a condition that was met, and of one that is not."""


class ChainStep(Struct, frozen=True):
    """What one unit spent its time with."""

    what: str
    ns: int

    def __str__(self) -> str:
        return f"{self.what} for {duration(self.ns)}"


class Link(Struct, frozen=True):
    """One unit of the chain."""

    name: str
    result: str
    """``loaded``, ``not active yet`` and so on."""
    at_ns: int
    """Log time of that; 0: it has not come to it."""
    steps: tuple[ChainStep, ...]
    """From when the one before had come so far."""

    def text(self, started_ns: int) -> str:
        """Write it on one line: ``/box, started after 2.0 s: it was starting for 2.0 s``."""
        after = f" after {duration(self.at_ns - started_ns)}" if self.at_ns else ""
        steps = ", ".join(map(str, self.steps))
        return f"{self.name}, {self.result}{after}{f': {steps}' if steps else ''}"


class _Wait(Struct, frozen=True):
    """A unit that another one waits for."""

    unit: Unit
    condition: Condition
    until_ns: int
    """Log time when the condition was met; 0: it was not yet, or that is not recorded."""


def nodes_of_bring_up(timeline: Timeline) -> list[Unit]:
    """Give the nodes that the session began with, but for those that are not awaited any more."""
    begun = min((at for at, each in timeline.requests if each.action == "apply"), default=_NEVER)
    return [
        unit
        for unit in timeline.units
        if unit.kind is SubjectKind.NODE
        and (unit.changes and unit.changes[0][0] < begun)
        and not unit.is_guest
        and (unit.arrival or not (unit.is_withdrawn or unit.is_dismissed))
    ]


def left_behind(timeline: Timeline) -> dict[str, list[str]]:
    """Give the nodes that were not requested because their container was never ready, by it."""
    found: dict[str, list[str]] = {}
    for unit in timeline.units:
        if unit.state is not NodeState.PENDING or unit.is_withdrawn or unit.is_dismissed:
            continue
        if not unit.reason and not timeline.of_name(unit.container).ready_ns:
            found.setdefault(unit.container, []).append(unit.name)
    return found


def critical_chain(timeline: Timeline, last: Unit) -> tuple[Link, ...]:
    """Give the chain that this node is the end of, from it back to the start."""
    found: list[Link] = []
    seen = set[str]()
    started_ns, end_ns = timeline.session.started_ns, timeline.session.reader.end
    wait: _Wait | None = _Wait(last, Condition.LOADED, last.ready_ns)
    while wait is not None and wait.unit.key not in seen:
        seen.add(wait.unit.key)
        before = _before(timeline, wait.unit)
        since_ns = (before.until_ns or end_ns) if before else started_ns
        steps = tuple(_steps(wait, since_ns, wait.until_ns or end_ns))
        found.append(Link(wait.unit.name, _result(wait), wait.until_ns, steps))
        wait = before
    return tuple(found)


def _result(wait: _Wait) -> str:
    met, unmet = _RESULTS[wait.condition]
    arrival = wait.unit.arrival
    if wait.condition is Condition.LOADED and arrival not in {None, NodeState.LOADED}:
        return str(arrival)  # in its constructor, or instead of it
    return met if wait.until_ns else unmet


def _before(timeline: Timeline, unit: Unit) -> _Wait | None:
    """Find what was met last before a unit began; while it waits, what is not met yet."""
    waits = list(_waits(timeline, unit))
    unmet = next((each for each in waits if not each.until_ns), None)
    begun_ns = unit.begun_ns
    if not begun_ns and unmet:
        return unmet
    met = [each for each in waits if each.until_ns and _is_before(each.until_ns, begun_ns)]
    latest = max(met, key=lambda each: each.until_ns, default=None)
    if unmet and (latest is None or begun_ns - latest.until_ns > _BRIEF):
        latest = replace(unmet, until_ns=begun_ns)
    start_ns = unit.constructing_ns or begun_ns
    if latest and start_ns - latest.until_ns <= _BRIEF:
        return latest
    # Some containers load one node after the other.
    turn = [
        _Wait(each, Condition.LOADED, each.ready_ns)
        for each in timeline.units
        if unit.container and each.container == unit.container and each is not unit
        if each.ready_ns <= start_ns + _BRIEF and start_ns - each.ready_ns <= _BRIEF
    ]
    return turn[0] if turn else latest


def _is_before(at_ns: int, begun_ns: int) -> bool:
    return at_ns <= begun_ns + _BRIEF or not begun_ns


def _waits(timeline: Timeline, unit: Unit) -> Iterator[_Wait]:
    own = [(Condition.STARTED, unit.container)] if unit.container else []
    for condition, key in [*own, *_dependencies(timeline, unit.key)]:
        nodes = [each for each in timeline.units if each.container == key and each.is_known]
        if condition is Condition.LOADED and nodes:
            latest = max(nodes, key=lambda each: each.ready_ns or _NEVER)
            yield _Wait(latest, condition, latest.ready_ns)
        elif other := next((each for each in timeline.units if each.key == key), None):
            yield _Wait(other, condition, _met_ns(other, condition))


def _dependencies(timeline: Timeline, key: str) -> list[tuple[Condition, str]]:
    """Give the conditions about units of a unit's `depends_on`."""
    try:
        found = timeline.session.resolved["start_rules"][key]["dependencies"]
        named = [(Condition(each["condition"]), each["unit"]) for each in found if each["unit"]]
    except (KeyError, TypeError, ValueError):
        return []
    return [each for each in named if each[0] in _RESULTS]


def _met_ns(unit: Unit, condition: Condition) -> int:
    match condition:
        case Condition.STARTED | Condition.LOADED:
            return unit.ready_ns
        case Condition.ACTIVE:
            return unit.active_ns
        case Condition.EXITED:
            exits = (at for at, state, _ in unit.changes if state is ProcessEventKind.EXITED)
            return next(exits, 0)
    return 0


def _steps(wait: _Wait, since_ns: int, until_ns: int) -> Iterator[ChainStep]:
    unit = wait.unit
    why = f" ({unit.waited})" if unit.waited else ""
    stays = [(f"it waited to be started{why}", unit.begun_ns), ("it was starting", unit.ready_ns)]
    if unit.kind is SubjectKind.NODE:
        stays = [
            (f"its load waited{why}", unit.begun_ns),
            ("it waited for its turn", unit.constructing_ns or unit.begun_ns),
            ("its constructor ran" if unit.constructing_ns else "it was loading", unit.ready_ns),
        ]
    is_activation = wait.condition is Condition.ACTIVE
    stays.append(("it was being activated" if is_activation else "it ran", _NEVER))
    for what, end_ns in stays:
        # What has no end yet lasts.
        end = min(end_ns or until_ns, until_ns)
        if end - since_ns >= _BRIEF:
            yield ChainStep(what, end - since_ns)
        since_ns = max(since_ns, end)
