"""How the session is recorded, with defaults where the file says nothing."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from msgspec.structs import replace

from play_launch.config.model import (
    DEFAULT_TOPICS,
    BeforeCrashConfig,
    KeepConfig,
    RecordConfig,
    RotateConfig,
    SamplingConfig,
)

if TYPE_CHECKING:
    from play_launch.config.schema import BeforeCrashSection, RecordSection

_PARTS: Final = {
    "rotate": RotateConfig(),
    "keep": KeepConfig(),
    "sampling": SamplingConfig(),
}


def resolve_record(section: RecordSection | None) -> RecordConfig:
    """Return what `section` says; it is None where the file has no such section."""
    if section is None:
        return RecordConfig()
    given = section.given
    for name, default in _PARTS.items():
        part = given.get(name)
        given[name] = default if part is None else replace(default, **part.given)
    given["topics"] = tuple(dict.fromkeys((*DEFAULT_TOPICS, *given.get("topics", ()))))
    given["exclude"] = tuple(given.get("exclude", ()))
    if isinstance(budget := given.get("budget"), dict):
        given["budget"], given["topic_budgets"] = None, tuple(budget.items())
    if (before_crash := given.get("before_crash")) is not None:
        given["before_crash"] = _before_crash(before_crash)
    return RecordConfig(**given)


def _before_crash(section: BeforeCrashSection) -> BeforeCrashConfig:
    given = section.given
    return BeforeCrashConfig(tuple(given.pop("topics")), **given)
