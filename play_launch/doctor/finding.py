"""What is found out about one subject, in words."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Iterable

_MEBIBYTE: Final = 1024**2
_GIBIBYTE: Final = 1024**3


class Level(StrEnum):
    """How bad it is."""

    OK = "ok"
    WARN = "warn"
    """It works, but something is lost: the finding says what."""
    FAIL = "fail"
    """No system can be brought up like this."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One line of the report.

    Attributes:
        subject: What it is about, in a word or two.
        level: How bad it is.
        says: What was found.
        impact: What does not work because of it; empty when nothing is lost.
        fix: What to do about it; empty when there is nothing to do.
    """

    subject: str
    level: Level
    says: str
    impact: str = ""
    fix: str = ""


def ok(subject: str, says: str, fix: str = "") -> Finding:
    """All is well; ``fix`` is how there would be more of it, where that may matter."""
    return Finding(subject, Level.OK, says, fix=fix)


def warn(subject: str, says: str, impact: str, fix: str) -> Finding:
    """Something is lost."""
    return Finding(subject, Level.WARN, says, impact, fix)


def fail(subject: str, says: str, impact: str, fix: str) -> Finding:
    """Nothing works like this."""
    return Finding(subject, Level.FAIL, says, impact, fix)


def can_run(findings: Iterable[Finding]) -> bool:
    """Whether a system can be brought up."""
    return all(finding.level is not Level.FAIL for finding in findings)


def size_text(size: int | None) -> str:
    """Write a number of bytes; None is unlimited."""
    if size is None:
        return "unlimited"
    if size >= _GIBIBYTE:
        return f"{size / _GIBIBYTE:.1f} GiB"
    return f"{size / _MEBIBYTE:.0f} MiB"
