"""What was wrong in a session, as data; `play_launch.cli` has the words for it."""

from __future__ import annotations

from enum import StrEnum
from typing import Final, NamedTuple

from msgspec import Struct

from play_launch.postmortem.frames import Frame, Signature  # noqa: TC001 - fields of a Struct
from play_launch.postmortem.parameters import ParametersOfALife  # noqa: TC001 - as above
from play_launch.postmortem.source_lines import Module, SourceLine  # noqa: TC001 - as above


class Kind(StrEnum):
    """What can be wrong."""

    CRASHED = "crashed"
    """A composable node died alone."""
    DIED = "died"
    """A container or an ordinary process exited unrequested, and not with status 0."""
    LOAD_FAILED = "load_failed"
    KILLED = "killed"
    """The supervisor killed a container: it was frozen, or waited for the dead."""
    NOT_LOADED = "not_loaded"
    """A node never came up, and nothing says that it failed."""
    INTERRUPTED = "interrupted"
    """The recording took nothing for a time."""
    DISK_FULL = "disk_full"
    """It ends where the disk of the recording is full."""
    STARVED = "starved"
    """Something used the processor so much that others waited for it."""
    DEAF = "deaf"
    """It did not end when it was asked to, and was killed."""
    SLOW = "slow"
    """A constructor took longer than `loading_timeout`."""
    GREW = "grew"
    """Something used more and more of what is limited."""
    UNFINISHED = "unfinished"
    """The recording has no end."""


class Importance(NamedTuple):
    """How much a kind matters."""

    rank: int
    """Small numbers come first; what has the same is in the order of time."""
    is_failure: bool
    """Whether it is reported as something wrong."""


IMPORTANCE: Final = {
    Kind.CRASHED: Importance(0, True),
    Kind.DIED: Importance(0, True),
    Kind.LOAD_FAILED: Importance(0, True),
    Kind.KILLED: Importance(0, True),
    Kind.INTERRUPTED: Importance(1, True),
    Kind.DISK_FULL: Importance(1, True),
    Kind.NOT_LOADED: Importance(2, True),
    Kind.STARVED: Importance(3, True),
    Kind.DEAF: Importance(4, True),
    Kind.SLOW: Importance(5, True),
    Kind.GREW: Importance(6, True),
    Kind.UNFINISHED: Importance(7, False),
}


class Quantity(StrEnum):
    """What can grow; its unit."""

    MEMORY = "memory_bytes"
    THREADS = "threads"
    DESCRIPTORS = "descriptors"
    PROCESSOR = "cpu_percent"
    """Of one core."""
    WAITING = "involuntary_switches_per_s"
    """How often per second it lost its core to others, although it had work."""
    FREE_MEMORY = "memory_available_bytes"
    FREE_DISK = "disk_free_bytes"
    PRESSURE = "cpu_some_avg10"
    """Percent of the time in which something waited for a core."""


class Trend(Struct, frozen=True):
    """How a number went; times are nanoseconds since the epoch."""

    who: str
    """Name of the node, container or process; empty for the machine."""
    quantity: Quantity
    before: float
    after: float
    begin_ns: int
    end_ns: int


class Place(Struct, frozen=True, kw_only=True):
    """Where it happened; what is not known is empty."""

    frame: Frame | None = None
    line: SourceLine | None = None
    package: str = ""
    plugin: str = ""
    container: str = ""
    config: str = ""
    """``robot.yaml:12``: where it is declared."""
    command: tuple[str, ...] = ()
    """Of an ordinary process or a container."""


class Away(Struct, frozen=True):
    """Downtime of a node or process."""

    who: str
    ns: int | None
    """Nanoseconds; None: until the end."""


class Finding(Struct, frozen=True, kw_only=True):
    """One thing that was wrong; equal things that happened to the same are one."""

    kind: Kind
    who: str
    """Name of the node, container or process; empty for the machine."""
    times_ns: tuple[int, ...]
    """When it happened, in nanoseconds since the epoch; the first is what the rest is about."""
    cause: str = ""
    """As it was recorded."""
    known: str = ""
    """Name of the well-known cause, see `play_launch.postmortem.known_causes`."""
    place: Place = Place()
    frames: tuple[Frame, ...] = ()
    lines: tuple[SourceLine | None, ...] = ()
    """Of each frame; empty before they are looked up."""
    modules: tuple[Module, ...] = ()
    signature: Signature | None = None
    state: str = ""
    """Which state it was in before, in the recording's words (``loaded``); empty: not known."""
    since_ns: int = 0
    """Since when, in nanoseconds since the epoch."""
    last_lines: tuple[str, ...] = ()
    before: tuple[Trend, ...] = ()
    """What grew or starved before."""
    parameters: ParametersOfALife | None = None
    """Those that it had in the life that ended so; None: not known."""
    hit: tuple[str, ...] = ()
    """Names of others that were not there because of it, or waited."""
    done: tuple[str, ...] = ()
    """What the supervisor did."""
    away: tuple[Away, ...] = ()
    problems: tuple[str, ...] = ()
    """Why something that one would expect to read here is not known."""

    @property
    def at_ns(self) -> int:
        """When it happened first."""
        return self.times_ns[0]


def is_crash(kind: Kind, signature: Signature | None) -> bool:
    """Whether something ended by a fault: what every command counts as a crash.

    A load that failed is one when the constructor took its process along.
    """
    return kind in _ENDS and signature is not None


_ENDS: Final = frozenset({Kind.CRASHED, Kind.DIED, Kind.LOAD_FAILED})


def by_importance(findings: list[Finding]) -> tuple[Finding, ...]:
    """Sort them: what failed first comes first."""
    return tuple(sorted(findings, key=lambda each: (IMPORTANCE[each.kind].rank, each.at_ns)))


def is_wrong(findings: tuple[Finding, ...]) -> bool:
    """Whether any of them is a failure."""
    return any(IMPORTANCE[each.kind].is_failure for each in findings)
