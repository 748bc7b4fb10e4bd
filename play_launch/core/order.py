"""Who may start now: rules and what holds give verdicts. Pure; times are seconds of any clock.

Conditions are for the first start. Once a unit was let through, or somebody has started it, its
automatic restarts wait for nothing.
"""

from __future__ import annotations

from enum import StrEnum, auto
from typing import TYPE_CHECKING, NamedTuple

from msgspec import Struct, field
from msgspec.structs import replace

from play_launch.core.dependency import Otherwise

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from play_launch.core.dependency import Dependency, StartRule


class Standing(StrEnum):
    """How a condition stands."""

    HOLDS = auto()
    OPEN = auto()
    """It does not hold, and may yet."""
    NEVER = auto()
    """It cannot hold any more by itself."""


class Look(NamedTuple):
    """What a look at a condition says; the reason is empty unless it is NEVER."""

    standing: Standing
    reason: str = ""


class Waiting(Struct, frozen=True):
    """One that waits; times are seconds."""

    since: float
    held_since: float | None = None
    """When all conditions held, or were waived: its delay runs."""


class OrderRecord(Struct, frozen=True):
    """Who waits, and who waits no longer, since when in seconds."""

    waiting: Mapping[str, Waiting] = field(default_factory=dict)
    released: Mapping[str, float] = field(default_factory=dict)


class Verdict(Struct, frozen=True):
    """What becomes of one that waited: it starts, or fails."""

    unit: str
    fails: bool
    reason: str = ""
    """Why it fails, or starts although a condition does not hold; else empty."""


class Decision(NamedTuple):
    """Result of a look at all that wait."""

    record: OrderRecord
    verdicts: tuple[Verdict, ...]
    missing: Mapping[str, tuple[Dependency, ...]]
    """Of each that waits on: what it waits for; nothing where only its delay runs."""
    next_at: float | None
    """When to look again even if nothing happens; None where time changes nothing."""


def want(record: OrderRecord, unit: str, now: float) -> OrderRecord:
    """A unit is to start as soon as it may."""
    return replace(record, waiting={**record.waiting, unit: Waiting(now)})


def forget(record: OrderRecord, unit: str) -> OrderRecord:
    """Nobody wants a unit any more; the next time it waits anew."""
    waiting = {name: each for name, each in record.waiting.items() if name != unit}
    return replace(record, waiting=waiting)


def release(record: OrderRecord, unit: str, now: float) -> OrderRecord:
    """A unit waits no longer: it was let through, or somebody starts it all the same."""
    return replace(forget(record, unit), released={**record.released, unit: now})


def decide(
    rules: Mapping[str, StartRule],
    record: OrderRecord,
    look: Callable[[Dependency], Look],
    now: float,
) -> Decision:
    """Look at all that wait, in the order in which they began to."""
    verdicts: list[Verdict] = []
    missing: dict[str, tuple[Dependency, ...]] = {}
    times: list[float] = []
    after = record
    for unit, waiting in record.waiting.items():
        state = _look_at(rules, record, unit, look, now)
        if state.failure:
            after = forget(after, unit)
            verdicts.append(Verdict(unit, fails=True, reason=state.failure))
            continue
        times += state.deadlines
        if state.open:
            missing[unit] = state.open
            after = _with(after, unit, replace(waiting, held_since=None))
            continue
        held_since = now if waiting.held_since is None else waiting.held_since
        due = held_since + rules[unit].delay
        if now >= due:
            after = release(after, unit, now)
            verdicts.append(Verdict(unit, fails=False, reason=state.waived))
        else:
            missing[unit] = ()
            times.append(due)
            after = _with(after, unit, replace(waiting, held_since=held_since))
    return Decision(after, tuple(verdicts), missing, min(times, default=None))


class _State(NamedTuple):
    open: tuple[Dependency, ...]
    failure: str
    waived: str
    deadlines: tuple[float, ...]


def _look_at(
    rules: Mapping[str, StartRule],
    record: OrderRecord,
    unit: str,
    look: Callable[[Dependency], Look],
    now: float,
) -> _State:
    still_open: list[Dependency] = []
    waived: list[str] = []
    deadlines: list[float] = []
    for dependency in rules[unit].dependencies:
        standing, reason = look(dependency)
        if standing is Standing.HOLDS:
            continue
        if standing is Standing.OPEN:
            deadline = _deadline(record, unit, dependency)
            if deadline is None or now < deadline:
                still_open.append(dependency)
                if deadline is not None:
                    deadlines.append(deadline)
                continue
            reason = f"not within {dependency.timeout:g} s"
        text = f"it waited for {dependency}: {reason}"
        if dependency.otherwise is Otherwise.FAIL:
            return _State((), text, "", ())
        waived.append(text)
    return _State(tuple(still_open), "", "; ".join(waived), tuple(deadlines))


def _deadline(record: OrderRecord, unit: str, dependency: Dependency) -> float | None:
    """When its time is over; None as long as what it is about waits itself, or without limit."""
    if dependency.timeout == float("inf") or dependency.unit in record.waiting:
        return None
    since = record.waiting[unit].since
    return max(since, record.released.get(dependency.unit, since)) + dependency.timeout


def _with(record: OrderRecord, unit: str, waiting: Waiting) -> OrderRecord:
    if record.waiting[unit] == waiting:
        return record
    return replace(record, waiting={**record.waiting, unit: waiting})
