"""The loads of a composition container, and what is said about them to whoever carries them out."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum, auto
from typing import TypeAlias


class Stage(StrEnum):
    """Where a load is."""

    QUEUED = auto()
    """It waits for those before it."""
    NEXT = auto()
    """Its turn has come; it is being sent."""
    SENT = auto()
    """No answer yet."""
    SAID_LOADED = auto()
    """The answer says so; the list has not."""
    SAID_FAILED = auto()
    LOADED = auto()
    UNLOADING = auto()


@dataclass(frozen=True, slots=True)
class Wanted:
    """What is known beforehand about a node's name; empty where it is the component's own."""

    full_name: str = ""
    namespace: str = ""
    label: str = ""
    """Distinguishes nodes that have no name."""

    def is_called(self, full_name: str) -> bool:
        """Whether a node of that name may be it."""
        if self.full_name:
            return full_name == self.full_name
        return full_name.startswith(f"{self.namespace.rstrip('/')}/")


@dataclass(slots=True)
class Load:
    """One attempt, as far as it has come."""

    attempt: int
    wanted: Wanted
    stage: Stage = Stage.QUEUED
    unique_id: int = 0
    full_name: str = ""
    adopted: bool = False
    """Whether it is, or may be, one that was there before."""
    is_presumed: bool = False
    """Whether nothing was sent for it, because there seems to be one."""
    reason: str = ""
    """What the container said against it."""
    before: frozenset[int] = frozenset()
    """Nodes that were there before it was sent."""
    is_asked_about: bool = False
    """Whether it is sent and silent, and the list is to decide."""
    list_from: int = 0
    """The first list that may count for it."""
    absent: int = 0
    """Such lists without it."""


@dataclass(frozen=True, slots=True)
class SendLoad:
    """Send LoadNode for an attempt, then call `sent`."""

    attempt: int


@dataclass(frozen=True, slots=True)
class SendUnload:
    """Send UnloadNode."""

    unique_id: int


@dataclass(frozen=True, slots=True)
class AskList:
    """Send ListNodes, after ``delay`` seconds; hand in the answer under ``serial``."""

    serial: int
    delay: float = 0.0


@dataclass(frozen=True, slots=True)
class ReportLoaded:
    """The node is there.

    Attributes:
        confirmed_by: Empty for an answer that the list agreed to, else what it was known by.
        remark: What was not as it should be; empty when all was well.
        adopted: Whether it had been there before.
    """

    attempt: int
    unique_id: int
    full_name: str
    confirmed_by: str = ""
    remark: str = ""
    adopted: bool = False


@dataclass(frozen=True, slots=True)
class ReportFailed:
    """The node is not there and will not be by this attempt."""

    attempt: int
    reason: str


@dataclass(frozen=True, slots=True)
class ReportUnloaded:
    """The node was there and is gone; empty ``reason``: as we asked."""

    attempt: int
    unique_id: int
    full_name: str
    reason: str = ""


@dataclass(frozen=True, slots=True)
class ReportRejected:
    """The node was to be unloaded and is still there."""

    unique_id: int
    reason: str


@dataclass(frozen=True, slots=True)
class Remark:
    """Something that a person should know."""

    text: str


Action: TypeAlias = (
    SendLoad
    | SendUnload
    | AskList
    | ReportLoaded
    | ReportFailed
    | ReportUnloaded
    | ReportRejected
    | Remark
)
