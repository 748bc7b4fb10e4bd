"""Result of one check."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Iterable

_GIBIBYTE: Final = 1024**3


class Level(StrEnum):
    """Severity of a finding."""

    OK = "ok"
    WARN = "warn"
    """It works, with a loss: the impact."""
    FAIL = "fail"
    """No system can be brought up."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One row of the report; impact and fix are empty where nothing is lost."""

    subject: str
    level: Level
    says: str
    impact: str = ""
    fix: str = ""


def ok(subject: str, says: str, fix: str = "") -> Finding:
    """Return a finding without loss; `fix` names what would allow more."""
    return Finding(subject, Level.OK, says, fix=fix)


def warn(subject: str, says: str, impact: str, fix: str) -> Finding:
    return Finding(subject, Level.WARN, says, impact, fix)


def fail(subject: str, says: str, impact: str, fix: str) -> Finding:
    return Finding(subject, Level.FAIL, says, impact, fix)


def can_run(findings: Iterable[Finding]) -> bool:
    """Whether a system can be brought up."""
    return all(finding.level is not Level.FAIL for finding in findings)


def size_text(size: int | None) -> str:
    """Format a number of bytes; None is unlimited."""
    if size is None:
        return "unlimited"
    if size >= _GIBIBYTE:
        return f"{size / _GIBIBYTE:.1f} GiB"
    return f"{size / 1024**2:.0f} MiB"
