"""Equal crashes of many sessions, as one group each."""

from __future__ import annotations

from typing import TYPE_CHECKING

from msgspec import Struct

from play_launch.postmortem.frames import Signature  # noqa: TC001 - a field of a Struct

if TYPE_CHECKING:
    from collections.abc import Iterable

    from play_launch.postmortem.bag_reader import BagReader
    from play_launch.postmortem.timeline import Timeline
    from play_launch.postmortem.units import Failure


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
            one = _group(signature, failure, version, timeline.session.reader)
            known = self._groups.get(signature)
            merged = one if known is None else _merged(known, one, again=signature in seen)
            self._groups[signature] = merged
            seen.add(signature)

    def sorted(self) -> tuple[CrashGroup, ...]:
        """Give the groups, the most frequent one first."""
        return tuple(sorted(self._groups.values(), key=lambda one: (-one.count, -one.last_ns)))


def _group(signature: Signature, failure: Failure, version: str, reader: BagReader) -> CrashGroup:
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


def _merged(old: CrashGroup, new: CrashGroup, *, again: bool) -> CrashGroup:
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
