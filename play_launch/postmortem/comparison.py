"""Several sessions: two beside each other, and the equal crashes of many as one group each."""

from __future__ import annotations

from enum import StrEnum
from typing import TYPE_CHECKING, Final

from msgspec import Struct

from play_launch.supervisor.events import MemoryKind
from play_launch.supervisor.frames import Signature  # noqa: TC001 - a field of a Struct

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from play_launch.postmortem.parameters import Parameters
    from play_launch.postmortem.timeline import Timeline


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
    name: str
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
    units: tuple[str, ...]
    """Those that crashed so, in either session."""
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
    before, after = _numbers(first), _numbers(second)
    old, new = before[Measure.RESTARTS].keys(), after[Measure.RESTARTS].keys()
    loaded = before[Measure.BRING_UP].keys() - after[Measure.BRING_UP].keys()
    return Comparison(
        changes=tuple(
            Deviation(each, name, before[each][name], after[each][name])
            for each in Measure
            for name in sorted(before[each].keys() & after[each].keys())
        ),
        new_crashes=tuple(each for each in crashes if each.before == 0),
        gone_crashes=tuple(each for each in crashes if each.after == 0),
        more_crashes=tuple(each for each in crashes if 0 < each.before < each.after),
        fewer_crashes=tuple(each for each in crashes if 0 < each.after < each.before),
        new_failures=tuple(sorted(loaded & new)),
        new_members=tuple(sorted(new - old)),
        gone_members=tuple(sorted(old - new)),
        parameters=tuple(_parameters(first.parameters, second.parameters)),
    )


def _numbers(timeline: Timeline) -> dict[Measure, dict[str, float]]:
    """Give the numbers of all units, by their keys; all units that are known have restarts."""
    started, units = timeline.session.started_ns, timeline.units
    known = (each for each in units if each.is_known and not each.is_withdrawn)
    totals = timeline.samples.totals()
    return {
        Measure.BRING_UP: {
            each.key: (each.loaded_ns - started) / 1e9 for each in units if each.loaded_ns
        },
        Measure.RESTARTS: {each.key: each.restarts for each in known},
        # Nodes that share the memory of their container have none of their own.
        Measure.PEAK_MEMORY: {
            key: total.peak_memory
            for key, total in totals.items()
            if total.latest.memory_kind != MemoryKind.SHARED
        },
        Measure.CPU: {
            key: mean for key, total in totals.items() if (mean := total.mean_cpu) is not None
        },
    }


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
    groups = CrashGroups()
    groups.add(first)
    before = {group.signature: group.count for group in groups.sorted()}
    groups.add(second)
    changes = []
    for group in sorted(groups.sorted(), key=lambda one: one.signature):
        count = before.get(group.signature, 0)
        changes.append(CrashChange(group.signature, group.nodes, count, group.count - count))
    return changes


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
        self._crashes: dict[Signature, list[_Crash]] = {}

    def add(self, timeline: Timeline) -> None:
        version = timeline.session.about.get("play_launch_version", "")
        reader = timeline.session.reader
        for failure in timeline.failures:
            signature = failure.signature
            if not failure.is_crash or signature is None:
                continue
            places = "\n".join(signature.frames)
            builds = (
                f"{module.name} {module.build_id[:12]}"
                for module in failure.modules
                if f"({module.name})" in places
            )
            crash = _Crash(
                failure.name,
                len(failure.times),
                # Of several sessions only those by a clock that was set are in order.
                min(failure.times) + reader.ahead_ns,
                max(failure.times) + reader.ahead_ns,
                version,
                tuple(builds),
                failure.cause,
                str(reader.path),
            )
            self._crashes.setdefault(signature, []).append(crash)

    def sorted(self) -> tuple[CrashGroup, ...]:
        """Give the groups, the most frequent one first."""
        groups = (_group_of(signature, found) for signature, found in self._crashes.items())
        return tuple(sorted(groups, key=lambda one: (-one.count, -one.last_ns)))


class _Crash(Struct, frozen=True):
    """The crashes of one unit in one session with one signature."""

    name: str
    count: int
    first_ns: int
    last_ns: int
    version: str
    builds: tuple[str, ...]
    cause: str
    path: str


def _group_of(signature: Signature, crashes: Sequence[_Crash]) -> CrashGroup:
    latest = max(crashes, key=lambda one: one.last_ns)
    return CrashGroup(
        signature=signature,
        count=sum(one.count for one in crashes),
        first_ns=min(one.first_ns for one in crashes),
        last_ns=latest.last_ns,
        sessions=len({one.path for one in crashes}),
        nodes=tuple(sorted({one.name for one in crashes})),
        versions=tuple(sorted({one.version for one in crashes if one.version})),
        builds=tuple(sorted({build for one in crashes for build in one.builds})),
        cause=latest.cause,
        example=latest.path,
    )
