"""Several sessions: two beside each other, and the equal crashes of many as one group each."""

from __future__ import annotations

from enum import StrEnum
from typing import TYPE_CHECKING, Final

from msgspec import Struct

from play_launch.postmortem.frames import Signature  # noqa: TC001 - a field of a Struct

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from play_launch.postmortem.bag_reader import BagReader
    from play_launch.postmortem.parameters import Parameters
    from play_launch.postmortem.timeline import Timeline
    from play_launch.postmortem.units import Failure


class Measure(StrEnum):
    """What is compared, and its unit."""

    BRING_UP = "bring_up_s"
    """Seconds from the start of the session until a node is loaded."""
    RESTARTS = "restarts"
    """Of a container or process; of a node, how often it was loaded again."""
    PEAK_MEMORY = "peak_memory_bytes"
    CPU = "cpu_percent"
    """Of one core, on average."""


class Worse(Struct, frozen=True):
    """A number counts as worse when it is so many times as large, and so much larger."""

    factor: float
    least: float


RULES: Final[Mapping[Measure, Worse]] = {
    Measure.BRING_UP: Worse(1.5, 1.0),
    Measure.RESTARTS: Worse(1.0, 1.0),
    Measure.PEAK_MEMORY: Worse(1.5, 64e6),
    Measure.CPU: Worse(1.5, 10.0),
}
"""Smaller differences come from one run of the same system to the next."""


class Deviation(Struct, frozen=True):
    """One number in both sessions."""

    measure: Measure
    who: str
    """Key of the node, or name."""
    before: float
    after: float

    @property
    def is_worse(self) -> bool:
        """Whether the second is worse by the rules."""
        return _is_worse(self.measure, self.before, self.after)

    @property
    def is_better(self) -> bool:
        """Whether the first is worse by the rules."""
        return _is_worse(self.measure, self.after, self.before)


class CrashChange(Struct, frozen=True):
    """How often crashes of one signature happened."""

    signature: Signature
    who: tuple[str, ...]
    """Who crashed so, in either session."""
    before: int
    after: int


class ParameterChange(Struct, frozen=True):
    """A parameter that the sessions ended with different values of."""

    node: str
    name: str
    before: str | None
    """Values as JSON; None: it was not declared, or not set."""
    after: str | None


class Comparison(Struct, frozen=True):
    """What differs from the first session to the second."""

    changes: tuple[Deviation, ...]
    """All numbers that both have."""
    new_crashes: tuple[CrashChange, ...]
    """Of a signature that the first session does not have."""
    gone_crashes: tuple[CrashChange, ...]
    more_crashes: tuple[CrashChange, ...]
    """Of a signature that both have, more often in the second."""
    fewer_crashes: tuple[CrashChange, ...]
    new_failures: tuple[str, ...]
    """Keys of nodes that were loaded in the first session only."""
    new_members: tuple[str, ...]
    """Keys that only the second session has."""
    gone_members: tuple[str, ...]
    parameters: tuple[ParameterChange, ...]
    """Of nodes that gave theirs in both sessions."""

    @property
    def is_worse(self) -> bool:
        """Whether the second is worse: a new crash or more, a node that is missing, or a number."""
        return bool(self.new_crashes or self.more_crashes or self.new_failures) or any(
            change.is_worse for change in self.changes
        )


def compare(first: Timeline, second: Timeline) -> Comparison:
    """Compare two sessions, which were read to their ends."""
    crashes = _crash_changes(first, second)
    old, new = _members(first), _members(second)
    loaded = _bring_up(first).keys() - _bring_up(second).keys()
    return Comparison(
        changes=tuple(_changes(first, second)),
        new_crashes=tuple(each for each in crashes if each.before == 0),
        gone_crashes=tuple(each for each in crashes if each.after == 0),
        more_crashes=tuple(each for each in crashes if 0 < each.before < each.after),
        fewer_crashes=tuple(each for each in crashes if 0 < each.after < each.before),
        new_failures=tuple(sorted(loaded & new)),
        new_members=tuple(sorted(new - old)),
        gone_members=tuple(sorted(old - new)),
        parameters=tuple(_parameters(first.parameters, second.parameters)),
    )


def _changes(first: Timeline, second: Timeline) -> Iterator[Deviation]:
    for measure in Measure:
        before, after = _numbers(first, measure), _numbers(second, measure)
        for who in sorted(before.keys() & after.keys()):
            yield Deviation(measure, who, before[who], after[who])


def _numbers(timeline: Timeline, measure: Measure) -> Mapping[str, float]:
    match measure:
        case Measure.BRING_UP:
            return _bring_up(timeline)
        case Measure.PEAK_MEMORY:
            return timeline.samples.peak_memory()
        case Measure.CPU:
            return timeline.samples.mean_cpu()
        case Measure.RESTARTS:
            return _restarts(timeline)


def _bring_up(timeline: Timeline) -> dict[str, float]:
    started = timeline.session.started_ns
    return {each.key: (each.loaded_ns - started) / 1e9 for each in timeline.units if each.loaded_ns}


def _restarts(timeline: Timeline) -> dict[str, float]:
    return {
        each.key: each.restarts
        for each in timeline.units
        if each.is_known and not each.is_withdrawn
    }


def _members(timeline: Timeline) -> set[str]:
    return set(_restarts(timeline))


def _parameters(first: Parameters, second: Parameters) -> Iterator[ParameterChange]:
    for node in sorted(first.nodes.keys() & second.nodes.keys()):
        one, two = first.nodes[node], second.nodes[node]
        if not (one.asked_ns and two.asked_ns):
            continue
        for name in sorted(one.values.keys() | two.values.keys()):
            before, after = one.values.get(name), two.values.get(name)
            if before != after:
                yield ParameterChange(node, name, before, after)


def _crash_changes(first: Timeline, second: Timeline) -> list[CrashChange]:
    before, after = _crashes(first), _crashes(second)
    nothing: tuple[int, tuple[str, ...]] = (0, ())
    changes = []
    for signature in sorted(before.keys() | after.keys()):
        (one, old), (two, new) = before.get(signature, nothing), after.get(signature, nothing)
        changes.append(CrashChange(signature, tuple(dict.fromkeys((*old, *new))), one, two))
    return changes


def _crashes(timeline: Timeline) -> dict[Signature, tuple[int, tuple[str, ...]]]:
    found: dict[Signature, tuple[int, tuple[str, ...]]] = {}
    for failure in timeline.crashes:
        assert failure.signature is not None
        count, who = found.get(failure.signature, (0, ()))
        found[failure.signature] = (count + len(failure.times), (*who, failure.who))
    return found


def _is_worse(measure: Measure, before: float, after: float) -> bool:
    rule = RULES[measure]
    return after >= before * rule.factor and after - before >= rule.least


class CrashGroup(Struct, frozen=True, kw_only=True):
    """What has one signature."""

    signature: Signature
    count: int
    first_ns: int
    """Nanoseconds since the epoch."""
    last_ns: int
    sessions: int
    nodes: tuple[str, ...]
    """Names of those that crashed so, sorted."""
    versions: tuple[str, ...]
    """Of play-launch, sorted."""
    builds: tuple[str, ...]
    """``libdemo.so 4ae3b1c0ffee``: of the libraries of the signature, sorted."""
    cause: str
    """Of the latest one."""
    example: str
    """Path of the latest recording that has it."""


class CrashGroups:
    """Takes sessions one after the other, and keeps no more of them than is asked for."""

    def __init__(self) -> None:
        """Begin without any."""
        self._groups: dict[Signature, CrashGroup] = {}

    def add(self, timeline: Timeline) -> None:
        """Take the crashes of a session."""
        seen: set[Signature] = set()
        version = timeline.session.about.get("play_launch_version", "")
        for failure in timeline.crashes:
            signature = failure.signature
            assert signature is not None
            one = _group_of(signature, failure, version, timeline.session.reader)
            known = self._groups.get(signature)
            if known is not None:
                one = _merged_groups(known, one, again=signature in seen)
            self._groups[signature] = one
            seen.add(signature)

    def sorted(self) -> tuple[CrashGroup, ...]:
        """Give the groups, the most frequent one first."""
        return tuple(sorted(self._groups.values(), key=lambda one: (-one.count, -one.last_ns)))


def _group_of(
    signature: Signature, failure: Failure, version: str, reader: BagReader
) -> CrashGroup:
    places = "\n".join(signature.frames)
    builds = (
        f"{module.name} {module.build_id[:12]}"
        for module in failure.modules
        if f"({module.name})" in places
    )
    return CrashGroup(
        signature=signature,
        count=len(failure.times),
        # Of several sessions only those by a clock that was set are in order.
        first_ns=min(failure.times) + reader.ahead_ns,
        last_ns=max(failure.times) + reader.ahead_ns,
        sessions=1,
        nodes=(failure.who,),
        versions=tuple(filter(None, (version,))),
        builds=tuple(sorted(builds)),
        cause=failure.cause,
        example=str(reader.path),
    )


def _merged_groups(old: CrashGroup, new: CrashGroup, *, again: bool) -> CrashGroup:
    """Join two; ``again``: they are of one session."""
    latest = new if new.last_ns >= old.last_ns else old
    return CrashGroup(
        signature=old.signature,
        count=old.count + new.count,
        first_ns=min(old.first_ns, new.first_ns),
        last_ns=latest.last_ns,
        sessions=old.sessions + (0 if again else new.sessions),
        nodes=_joined(old.nodes, new.nodes),
        versions=_joined(old.versions, new.versions),
        builds=_joined(old.builds, new.builds),
        cause=latest.cause,
        example=latest.example,
    )


def _joined(old: Iterable[str], new: Iterable[str]) -> tuple[str, ...]:
    return tuple(sorted({*old, *new}))
