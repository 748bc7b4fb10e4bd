"""`record`: its keys, and the recording that they configure."""

from __future__ import annotations

from typing import Final

from msgspec.structs import replace

from play_launch.config import kinds
from play_launch.config.model import (
    DEFAULT_TOPICS,
    BeforeCrashConfig,
    KeepConfig,
    RecordConfig,
    RotateConfig,
    SamplingConfig,
)
from play_launch.config.section import Section, nested, optional, required


class RotateSection(Section):
    """`record.rotate`: when the recording goes on in a new file."""

    size: float | None = optional(
        kinds.SIZE_OR_NEVER, "Size of the file, or never. By default 1 GB.", "500 MB"
    )
    duration: float | None = optional(
        kinds.POSITIVE_DURATION_OR_NEVER,
        "Duration since it was begun, or never. By default 1 h.",
        "24 h",
    )


class KeepSection(Section):
    """`record.keep`: what is kept of earlier sessions."""

    sessions: int | None = optional(
        kinds.integer(1, 1_000_000), "Number of sessions. By default all.", 20
    )
    size: int | None = optional(
        kinds.SIZE, "Size of the sessions together. By default unlimited.", "10 GB"
    )


class SamplingSection(Section):
    """`record.sampling`: how often processes and the machine are measured."""

    period: float | None = optional(
        kinds.SAMPLING_PERIOD,
        "Duration from one sample to the next, at least 100 ms, or never. By default 1 s.",
        "5 s",
    )


class BeforeCrashSection(Section):
    """`record.before_crash`: what is kept in memory until something fails."""

    topics: list[str] = required(
        kinds.TOPIC_PATTERNS, "Topics that are kept in memory; * is any text.", ["/camera/*"]
    )
    seconds: float | None = optional(
        kinds.POSITIVE_DURATION, "Duration that is kept. By default 10 s.", "10 s"
    )
    megabytes: int | None = optional(
        kinds.integer(1, 1_000_000), "Memory for them, in 1,000,000 bytes. By default 256.", 512
    )


class RecordSection(Section):
    """`record`: how the session is recorded."""

    sync: float | None = optional(
        kinds.POSITIVE_DURATION_OR_NEVER,
        "Duration after which what was recorded is forced to the disk, or never.",
        "1 s",
        "never",
    )
    rotate: RotateSection | None = nested(
        RotateSection, "When the recording goes on in a new file.", {"size": "500 MB"}
    )
    keep: KeepSection | None = nested(
        KeepSection, "What is kept of earlier sessions.", {"sessions": 20}
    )
    sampling: SamplingSection | None = nested(
        SamplingSection, "How often processes and the machine are measured.", {"period": "5 s"}
    )
    ros: bool | None = optional(
        kinds.BOOLEAN, "Whether topics of ROS are recorded. By default true.", False
    )
    topics: list[str] | None = optional(
        kinds.list_of(kinds.TOPIC_PATTERN),
        "Topics to record beside /rosout, /diagnostics and /parameter_events; * is any text.",
        ["/tf", "/lidar/*"],
    )
    exclude: list[str] | None = optional(
        kinds.list_of(kinds.TOPIC_PATTERN), "Topics that are not recorded.", ["*/compressed"]
    )
    budget: int | dict[str, float] | None = optional(
        kinds.BUDGET, "Size that is recorded of each topic in a second at most.", "50 MB"
    )
    before_crash: BeforeCrashSection | None = nested(
        BeforeCrashSection,
        "What is kept in memory until something fails.",
        {"topics": ["/camera/*"], "seconds": "10 s"},
    )


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
