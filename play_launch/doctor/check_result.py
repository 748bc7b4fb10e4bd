"""Result of one check."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Final

_GIBIBYTE: Final = 1024**3


class Severity(StrEnum):
    """Severity of a finding."""

    OK = "ok"
    WARN = "warn"
    """It works, with a loss: the impact."""
    FAIL = "fail"
    """No system can be started."""


@dataclass(frozen=True, slots=True)
class CheckResult:
    """One row of the report; impact and fix are empty where nothing is lost."""

    subject: str
    level: Severity
    says: str
    impact: str = ""
    fix: str = ""


def ok(subject: str, says: str, fix: str = "") -> CheckResult:
    """Return a finding without loss; `fix` names what would allow more."""
    return CheckResult(subject, Severity.OK, says, fix=fix)


def warn(subject: str, says: str, impact: str, fix: str) -> CheckResult:
    return CheckResult(subject, Severity.WARN, says, impact, fix)


def fail(subject: str, says: str, impact: str, fix: str) -> CheckResult:
    return CheckResult(subject, Severity.FAIL, says, impact, fix)


def size_text(size: int | None) -> str:
    """Format a number of bytes; None is unlimited."""
    if size is None:
        return "unlimited"
    if size >= _GIBIBYTE:
        return f"{size / _GIBIBYTE:.1f} GiB"
    return f"{size / 1024**2:.0f} MiB"
