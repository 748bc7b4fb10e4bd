"""Limits of control groups as people write them."""

from __future__ import annotations

import re
from typing import Final

from play_launch.config.group_limits import NO_LIMIT, CpuMax
from play_launch.config.problems import excerpt
from play_launch.config.values import parse_size

MAX: Final = "max"
HIGHEST_PIDS: Final = 2**22
LEAST_QUOTA: Final = 1_000
LONGEST_PERIOD: Final = 1_000_000
"""Microseconds: the kernel takes quotas from 1 ms on, and periods from 1 ms to 1 s."""
_HIGHEST_QUOTA: Final = 2**40
_DEFAULT_PERIOD: Final = 100_000
_PERCENT: Final = re.compile(r"([0-9]{1,7}(?:\.[0-9]{1,3})?)\s*%", re.ASCII)
_PAIR: Final = re.compile(r"(max|[0-9]{1,13})(?:\s+([0-9]{1,7}))?", re.ASCII)
_CPU_FORMS: Final = 'a share of one CPU such as 50 % or 150 %, "quota period", or max'


def parse_cpu_max(value: object) -> CpuMax:
    """Return the CPU time in a period; raise ValueError with the fix."""
    text = value.strip() if isinstance(value, str) else ""
    if isinstance(value, int | float) and not isinstance(value, bool):
        raise ValueError(f"a number alone is ambiguous; write {value} % for a share of one CPU")  # noqa: TRY004 - pydantic collects ValueError
    if (found := _PERCENT.fullmatch(text)) is not None:
        limit = CpuMax(round(float(found[1]) * _DEFAULT_PERIOD / 100), _DEFAULT_PERIOD)
    elif (pair := _PAIR.fullmatch(text)) is not None and (pair[1] == MAX or pair[2]):
        quota = NO_LIMIT if pair[1] == MAX else int(pair[1])
        limit = CpuMax(quota, int(pair[2] or _DEFAULT_PERIOD))
    else:
        raise ValueError(f"expected {_CPU_FORMS}, given {excerpt(str(value))}")
    if not LEAST_QUOTA <= limit.period <= LONGEST_PERIOD:
        raise ValueError("the period, in microseconds, is 1000 to 1000000")
    if not limit.quota >= LEAST_QUOTA and limit.quota != NO_LIMIT:
        raise ValueError(
            "the kernel gives no less than 1000 microseconds in a period: at least 1 %, or a "
            "longer period"
        )
    if limit.quota > _HIGHEST_QUOTA and limit.quota != NO_LIMIT:
        raise ValueError("no machine has so many CPUs; write max")
    return limit


def parse_pids_max(value: object) -> float:
    """Return the number of processes and threads; raise ValueError with the fix."""
    if value == MAX:
        return NO_LIMIT
    if isinstance(value, bool) or not isinstance(value, int) or not 1 <= value <= HIGHEST_PIDS:
        raise ValueError(f"expected a number from 1 to {HIGHEST_PIDS}, or max")
    return value


def parse_memory(value: object) -> float:
    """Return the bytes; raise ValueError with the fix."""
    return NO_LIMIT if value == MAX else parse_size(value)


def parse_base_path(value: object) -> str:
    """Return the folder of a control group, empty for auto; raise ValueError with the fix."""
    if value == "auto":
        return ""
    text = value if isinstance(value, str) else ""
    if not text.startswith("/") or "\0" in text or ".." in text.split("/"):
        raise ValueError(
            "expected auto, or the folder of a control group, such as /sys/fs/cgroup/play_launch"
        )
    return text.rstrip("/") or "/"
