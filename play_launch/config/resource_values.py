"""CPUs, I/O priorities and limits of processes and control groups as people write them."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING, Final, NamedTuple

from play_launch.config.problems import excerpt
from play_launch.config.resources import (
    NO_LIMIT,
    CpuMax,
    IoClass,
    IoPriority,
    ResourceLimit,
    nice_limit,
)
from play_launch.config.values import parse_duration, parse_size

if TYPE_CHECKING:
    from collections.abc import Callable

HIGHEST_CPU: Final = 1023
_CPU_FORMS: Final = "CPUs such as 2, [0, 1] or 0-3,6"
_RANGE: Final = re.compile(r"([0-9]{1,4})(?:-([0-9]{1,4}))?", re.ASCII)
_IO: Final = re.compile(r"(realtime|best_effort)(?::([0-7]))?|idle", re.ASCII)
_IO_FORMS: Final = "idle, best_effort:0 to best_effort:7, or realtime:0 to realtime:7"
_MIDDLE_LEVEL: Final = 4
_MICROSECONDS: Final = 1_000_000
_LARGEST: Final = 2**63 - 1
_HIGHEST_PRIORITY: Final = 99


def parse_cpus(value: object) -> tuple[int, ...]:
    """Return the numbers in order; raise ValueError with the fix."""
    cpus: set[int] = set()
    for each in value if isinstance(value, list) else [value]:
        if isinstance(each, bool) or not isinstance(each, int | str):
            raise ValueError(f"expected {_CPU_FORMS}")  # noqa: TRY004 - pydantic collects ValueError
        for part in str(each).split(","):
            cpus |= _range(part.strip())
    if not cpus:
        raise ValueError(f"the list cannot be empty; give {_CPU_FORMS}")
    return tuple(sorted(cpus))


def _range(text: str) -> set[int]:
    found = _RANGE.fullmatch(text)
    if found is None:
        raise ValueError(f"expected {_CPU_FORMS}, given {excerpt(text)}")
    low = int(found[1])
    high = low if found[2] is None else int(found[2])
    if high > HIGHEST_CPU:
        raise ValueError(f"the highest CPU is {HIGHEST_CPU}, given {excerpt(text)}")
    if low > high:
        raise ValueError(f"{excerpt(text)} ends before it begins; write {high}-{low}")
    return set(range(low, high + 1))


def parse_io_priority(value: object) -> IoPriority:
    """Return the priority; raise ValueError with the fix."""
    found = _IO.fullmatch(value) if isinstance(value, str) else None
    if found is None:
        raise ValueError(f"expected {_IO_FORMS}, given {excerpt(str(value))}")
    if found[1] is None:
        return IoPriority(IoClass.IDLE)
    level = _MIDDLE_LEVEL if found[2] is None else int(found[2])
    return IoPriority(IoClass[found[1].upper()], level)


class LimitForm(NamedTuple):
    """How one limit is written, and how that becomes what the kernel counts."""

    shape: str
    """For editors."""
    parse: Callable[[object], float]
    meaning: str
    example: object


def _count(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= _LARGEST:
        raise ValueError(f"expected a number from 0 on, given {excerpt(str(value))}")
    return value


def _size(value: object) -> float:
    return 0 if value in {0, "0"} and not isinstance(value, bool) else parse_size(value)


def _seconds(value: object) -> float:
    return math.ceil(parse_duration(value))


def _microseconds(value: object) -> float:
    return math.ceil(parse_duration(value) * _MICROSECONDS)


def _nice(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int) or not -20 <= value <= 19:
        raise ValueError(f"expected a nice value from -20 to 19, given {excerpt(str(value))}")
    return nice_limit(value)


def _priority(value: object) -> float:
    priority = _count(value)
    if priority > _HIGHEST_PRIORITY:
        raise ValueError(f"expected a priority from 0 to {_HIGHEST_PRIORITY}")
    return priority


LIMIT_FORMS: Final = {
    "as": LimitForm("size", _size, "Size of its address space.", "4 GiB"),
    "core": LimitForm("size", _size, "Size of a core file.", "unlimited"),
    "cpu": LimitForm("duration", _seconds, "CPU time; SIGXCPU follows.", "10 min"),
    "data": LimitForm("size", _size, "Size of its data segment.", "2 GiB"),
    "fsize": LimitForm("size", _size, "Size of the files that it writes.", "10 GB"),
    "memlock": LimitForm("size", _size, "Size of memory that it may lock.", "unlimited"),
    "msgqueue": LimitForm("size", _size, "Size of POSIX message queues.", "1 MiB"),
    "nice": LimitForm("count", _nice, "Lowest nice value that it may give itself.", -10),
    "nofile": LimitForm("count", _count, "Number of open files.", 65536),
    "nproc": LimitForm("count", _count, "Number of processes and threads of the user.", 4096),
    "rtprio": LimitForm("count", _priority, "Highest real-time priority it may take.", 80),
    "rttime": LimitForm(
        "duration",
        _microseconds,
        "CPU time that a real-time thread may use without blocking.",
        "200 ms",
    ),
    "sigpending": LimitForm("count", _count, "Number of signals that wait.", 1024),
    "stack": LimitForm("size", _size, "Size of a thread's stack.", "16 MiB"),
}
"""By the names of setrlimit(2), in lower case."""


def limit_parser(name: str) -> Callable[[object], ResourceLimit]:
    """Give what reads the limit of this name: one value, or soft:hard."""
    parse = LIMIT_FORMS[name].parse

    def value_of(value: object) -> float:
        return math.inf if value == "unlimited" else parse(value)

    def parse_limit(value: object) -> ResourceLimit:
        if isinstance(value, str) and ":" in value:
            parts = [_number_or_text(part.strip()) for part in value.split(":", 1)]
            soft, hard = (value_of(part) for part in parts)
        else:
            soft = hard = value_of(value)
        if soft > hard:
            raise ValueError("the soft limit, before the colon, is higher than the hard limit")
        return ResourceLimit(name, soft, hard)

    return parse_limit


def _number_or_text(text: str) -> object:
    return int(text) if re.fullmatch(r"-?[0-9]{1,19}", text, re.ASCII) else text


MAX: Final = "max"
HIGHEST_PIDS: Final = 2**22
LEAST_QUOTA: Final = 1_000
LONGEST_PERIOD: Final = 1_000_000
"""Microseconds: the kernel takes quotas from 1 ms on, and periods from 1 ms to 1 s."""
_HIGHEST_QUOTA: Final = 2**40
_DEFAULT_PERIOD: Final = 100_000
_SHARE: Final = re.compile(r"([0-9]{1,7}(?:\.[0-9]{1,3})?)\s*%", re.ASCII)
_PAIR: Final = re.compile(r"(max|[0-9]{1,13})(?:\s+([0-9]{1,7}))?", re.ASCII)
_CPU_TIME_FORMS: Final = 'a share of one CPU such as 50 % or 150 %, "quota period", or max'


def parse_cpu_max(value: object) -> CpuMax:
    """Return the CPU time in a period; raise ValueError with the fix."""
    text = value.strip() if isinstance(value, str) else ""
    if isinstance(value, int | float) and not isinstance(value, bool):
        raise ValueError(f"a number alone is ambiguous; write {value} % for a share of one CPU")  # noqa: TRY004 - pydantic collects ValueError
    if (found := _SHARE.fullmatch(text)) is not None:
        limit = CpuMax(round(float(found[1]) * _DEFAULT_PERIOD / 100), _DEFAULT_PERIOD)
    elif (pair := _PAIR.fullmatch(text)) is not None and (pair[1] == MAX or pair[2]):
        quota = NO_LIMIT if pair[1] == MAX else int(pair[1])
        limit = CpuMax(quota, int(pair[2] or _DEFAULT_PERIOD))
    else:
        raise ValueError(f"expected {_CPU_TIME_FORMS}, given {excerpt(str(value))}")
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
