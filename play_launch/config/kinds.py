"""The kinds of values that keys of the configuration take: their checks, and their JSON Schema."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING, Any, Final, TypeAlias, TypeVar

from pydantic_core import core_schema

from play_launch.config.problems import excerpt
from play_launch.config.resources import (
    NO_LIMIT,
    CpuMax,
    IoClass,
    IoPriority,
    ResourceLimit,
    nice_limit,
)
from play_launch.config.section import ValueKind
from play_launch.config.values import (
    check_address,
    check_namespace,
    check_node_name,
    check_topic,
    check_topic_pattern,
    parse_duration,
    parse_positive_duration,
    parse_prefix,
    parse_size,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from enum import StrEnum

    from play_launch.config.section import JsonSchema, Value

    _Choice = TypeVar("_Choice", bound=StrEnum)

LOG_LEVELS = ("debug", "info", "warn", "error", "fatal")
SHORTEST_SAMPLING_PERIOD: Final = 0.1
"""Seconds; more often, measuring would show in what is measured."""
HIGHEST_CPU: Final = 1023
_LONGEST_RUN_NAME = 150
_PACKAGE_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_-]*", re.ASCII)
_SINGLE_COLON = re.compile(r"(?<!:):(?!:)")
_IDENTITY_RULE = re.compile(r"(?:[^:]*:)?__(?:node|name|ns):=")

STRING_FORM: Final[JsonSchema] = {"type": "string"}
_SUBSTITUTION: Final[JsonSchema] = {"type": "string", "pattern": r"\$[{(]"}
"""What stands in place of a number or a truth value and becomes one."""


def any_of(*forms: JsonSchema) -> JsonSchema:
    return forms[0] if len(forms) == 1 else {"anyOf": list(forms)}


def _pattern(pattern: str) -> JsonSchema:
    return {"type": "string", "pattern": pattern}


def _substitutable(*forms: JsonSchema) -> JsonSchema:
    return any_of(*forms, _SUBSTITUTION)


_NUMBER_AND_UNIT: Final = r"^\s*(\+?([0-9]+(\.[0-9]*)?|\.[0-9]+))\s*"
_DURATION_TEXT: Final = _pattern(rf"{_NUMBER_AND_UNIT}(us|ms|s|min|h)?\s*$")
_DURATION_FORM: Final = _substitutable({"type": "number", "minimum": 0}, _DURATION_TEXT)
_POSITIVE_FORM: Final = _substitutable({"type": "number", "exclusiveMinimum": 0}, _DURATION_TEXT)
_SIZE_FORM: Final = _substitutable(
    {"type": "number", "exclusiveMinimum": 0},
    _pattern(rf"{_NUMBER_AND_UNIT}([kMGT]?B|[KMGT]iB)?\s*$"),
)
_COUNT_FORM: Final = _substitutable({"type": "integer"})
_NEVER_FORM: Final[JsonSchema] = {"const": "never"}
_MAX_FORM: Final[JsonSchema] = {"const": "max"}
_CPU_FORMS: Final[list[JsonSchema]] = [
    {"type": "integer", "minimum": 0, "maximum": HIGHEST_CPU},
    _pattern(r"^\s*[0-9]{1,4}(-[0-9]{1,4})?(\s*,\s*[0-9]{1,4}(-[0-9]{1,4})?)*\s*$"),
]
SCALAR_FORM: Final[JsonSchema] = {"type": ["string", "number", "boolean"]}


def list_form(items: JsonSchema, least: int | None = None) -> JsonSchema:
    return {"type": "array", "items": items, **({"minItems": least} if least else {})}


def mapping_form(values: JsonSchema) -> JsonSchema:
    return {"type": "object", "additionalProperties": values}


def _checked(check: Callable[[Value], Value], kind: ValueKind[Value]) -> ValueKind[Value]:
    schema = core_schema.no_info_after_validator_function(check, kind.schema)
    return ValueKind(schema, kind.form)


def _parsed(parse: Callable[[Any], Value], *forms: JsonSchema) -> ValueKind[Value]:
    return ValueKind(core_schema.no_info_plain_validator_function(parse), any_of(*forms))


def _text(check: Callable[[str], str]) -> ValueKind[str]:
    return _checked(check, ValueKind(core_schema.str_schema(strict=True), STRING_FORM))


def integer(least: int, most: int) -> ValueKind[int]:
    schema = core_schema.int_schema(strict=True, ge=least, le=most)
    return ValueKind(schema, _substitutable({"type": "integer", "minimum": least, "maximum": most}))


def list_of(items: ValueKind[Value], *, least: int | None = None) -> ValueKind[list[Value]]:
    schema = core_schema.list_schema(items.schema, strict=True, min_length=least)
    return ValueKind(schema, list_form(items.form, least))


def choice(choices: Iterable[_Choice]) -> ValueKind[_Choice]:
    by_word = {str(each): each for each in choices}
    words = list(by_word)

    def parse(value: object) -> _Choice:
        if not isinstance(value, str) or value not in by_word:
            given = excerpt(str(value))
            raise ValueError(f"expected {', '.join(words[:-1])} or {words[-1]}, given {given}")
        return by_word[value]

    return _parsed(parse, _substitutable({"enum": words}))


def _or(word: str, parse: Callable[[object], float]) -> Callable[[object], float]:
    """Accept also a word for infinity."""
    return lambda value: math.inf if value == word else parse(value)


def _check_text(text: str) -> str:
    if "\x00" in text:
        raise ValueError("a NUL character cannot be passed to a program")
    return text


def _check_filled(text: str) -> str:
    if not text.strip():
        raise ValueError("cannot be empty")
    return _check_text(text)


def _check_command(command: list[str]) -> list[str]:
    if not command[0].strip():
        raise ValueError("the program, its first entry, cannot be empty")
    return command


def _check_executable(name: str) -> str:
    _check_filled(name)
    if "/" in name or name in {".", ".."}:
        raise ValueError(
            f"{excerpt(name)} is a path; give the name of a program of the package, without folders"
        )
    return name


def _check_run_name(name: str) -> str:
    _check_filled(name)
    if "/" in name or name in {".", ".."} or not name.isprintable():
        raise ValueError(f"{excerpt(name)} cannot name a directory; use letters, digits, - and _")
    if len(name.encode()) > _LONGEST_RUN_NAME:
        raise ValueError(
            f"at most {_LONGEST_RUN_NAME} bytes, because a directory is named after it"
        )
    return name


def _check_package(name: str) -> str:
    if not _PACKAGE_NAME.fullmatch(name):
        raise ValueError(f"{excerpt(name)} is not the name of a package (letters, digits, _ and -)")
    return name


def _check_plugin(name: str) -> str:
    _check_filled(name)
    if name != name.strip() or "/" in name or _SINGLE_COLON.search(name):
        raise ValueError(f"{excerpt(name)} is not a C++ class such as demo::Talker")
    return name


def _check_ros_argument(argument: str) -> str:
    if argument in {"--ros-args", "--"}:
        raise ValueError(f"leave {argument} out; it is put around ros_arguments")
    if _IDENTITY_RULE.match(argument):
        raise ValueError("use the keys name and namespace to rename a node")
    return _check_text(argument)


def _check_version(version: int) -> int:
    if version != 1:
        raise ValueError(f"this program reads version 1, not {version}")
    return version


def _check_regular_expression(pattern: str) -> str:
    try:
        re.compile(_check_filled(pattern))
    except re.error as error:
        raise ValueError(f"{excerpt(pattern)} is not a regular expression: {error}") from None
    return pattern


def _parse_sampling_period(value: object) -> float:
    period = parse_duration(value)
    if period < SHORTEST_SAMPLING_PERIOD:
        raise ValueError(
            f"must be at least {SHORTEST_SAMPLING_PERIOD * 1000:g} ms, or never for no samples"
        )
    return period


def _parse_rate(value: object) -> float:
    number = value.strip().removesuffix("Hz") if isinstance(value, str) else value
    try:
        rate = math.nan if isinstance(number, bool) else float(number)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        rate = math.nan
    if not 0 < rate < math.inf:
        raise ValueError(f"expected a rate such as 10 or 10 Hz, given {excerpt(str(value))}")
    return rate


def _parse_log_level(value: object) -> str:
    level = value.lower() if isinstance(value, str) else ""
    if level == "warning":
        raise ValueError('the level is called "warn"')
    if level not in LOG_LEVELS:
        raise ValueError(f"expected one of {', '.join(LOG_LEVELS)}, given {excerpt(str(value))}")
    return level


def _parse_budget(
    value: object, of_topics: Callable[[object], dict[str, float]]
) -> int | dict[str, float]:
    if not isinstance(value, dict):
        return parse_size(value)
    budgets = of_topics(value)
    if len(budgets) < len(value):
        raise ValueError("two of its topics are the same; a name begins with / anyway")
    return budgets


BOOLEAN: Final[ValueKind[bool]] = ValueKind(
    core_schema.bool_schema(strict=True), _substitutable({"type": "boolean"})
)
THREADS: Final = integer(1, 1024)
DURATION: Final = _parsed(parse_duration, _DURATION_FORM)
POSITIVE_DURATION: Final = _parsed(parse_positive_duration, _POSITIVE_FORM)
POSITIVE_DURATION_OR_NEVER: Final = _parsed(
    _or("never", parse_positive_duration), _POSITIVE_FORM, _NEVER_FORM
)
SAMPLING_PERIOD: Final = _parsed(_or("never", _parse_sampling_period), _DURATION_FORM, _NEVER_FORM)
SIZE: Final = _parsed(parse_size, _SIZE_FORM)
SIZE_OR_NEVER: Final = _parsed(_or("never", parse_size), _SIZE_FORM, _NEVER_FORM)
LOG_LEVEL: Final = _parsed(
    _parse_log_level,
    {"enum": list(LOG_LEVELS)},
    _SUBSTITUTION,
    _pattern(f"^({'|'.join(LOG_LEVELS).upper()})$"),
)
TEXT: Final = _text(_check_text)
FILLED_TEXT: Final = _text(_check_filled)
PREFIX: Final = _parsed(parse_prefix, any_of(STRING_FORM, list_form(STRING_FORM)))
COMMAND: Final = _checked(_check_command, list_of(TEXT, least=1))
PACKAGE: Final = _text(_check_package)
EXECUTABLE: Final = _text(_check_executable)
NODE_NAME: Final = _text(check_node_name)
# An empty name is the component's own, as in ROS's launch API.
OWN_NODE_NAME: Final = _text(lambda name: check_node_name(name) if name else name)
NAMESPACE: Final = _text(check_namespace)
TOPIC_PATTERN: Final = _text(check_topic_pattern)
RATE: Final = _parsed(
    _parse_rate,
    _substitutable({"type": "number", "exclusiveMinimum": 0}, _pattern(rf"{_NUMBER_AND_UNIT}Hz$")),
)
ADDRESS: Final = _text(check_address)
GRAPH_NAME: Final = _text(lambda name: check_topic(f"/{name.removeprefix('/')}"))
BUDGET: Final[ValueKind[int | dict[str, float]]] = ValueKind(
    core_schema.no_info_wrap_validator_function(
        _parse_budget,
        core_schema.dict_schema(TOPIC_PATTERN.schema, SIZE_OR_NEVER.schema, strict=True),
    ),
    any_of(_SIZE_FORM, mapping_form(SIZE_OR_NEVER.form)),
)
RUN_NAME: Final = _text(_check_run_name)
PLUGIN: Final = _text(_check_plugin)
ROS_ARGUMENTS: Final = list_of(_text(_check_ros_argument))
VERSION: Final = _checked(
    _check_version,
    ValueKind(core_schema.int_schema(strict=True), _substitutable({"const": 1})),
)
REGULAR_EXPRESSION: Final = _text(_check_regular_expression)


_CPUS_SHOWN: Final = "CPUs such as 2, [0, 1] or 0-3,6"
_RANGE: Final = re.compile(r"([0-9]{1,4})(?:-([0-9]{1,4}))?", re.ASCII)
_IO: Final = re.compile(r"(realtime|best_effort)(?::([0-7]))?|idle", re.ASCII)
_IO_SHOWN: Final = "idle, best_effort:0 to best_effort:7, or realtime:0 to realtime:7"
_SHARE: Final = re.compile(r"([0-9]{1,7}(?:\.[0-9]{1,3})?)\s*%", re.ASCII)
_QUOTA: Final = re.compile(r"(max|[0-9]{1,13})(?:\s+([0-9]{1,7}))?", re.ASCII)
_CPU_TIME_SHOWN: Final = 'a share of one CPU such as 50 % or 150 %, "quota period", or max'
_LEAST_QUOTA: Final = 1_000
_HIGHEST_QUOTA: Final = 2**40
_LONGEST_PERIOD: Final = 1_000_000
"""Microseconds: the kernel takes quotas from 1 ms on, and periods from 1 ms to 1 s."""


def parse_cpus(value: object) -> tuple[int, ...]:
    cpus: set[int] = set()
    for each in value if isinstance(value, list) else [value]:
        if isinstance(each, bool) or not isinstance(each, int | str):
            raise ValueError(f"expected {_CPUS_SHOWN}")  # noqa: TRY004 - pydantic collects ValueError
        for part in str(each).split(","):
            cpus |= _cpu_range(part.strip())
    if not cpus:
        raise ValueError(f"the list cannot be empty; give {_CPUS_SHOWN}")
    return tuple(sorted(cpus))


def _cpu_range(text: str) -> set[int]:
    found = _RANGE.fullmatch(text)
    if found is None:
        raise ValueError(f"expected {_CPUS_SHOWN}, given {excerpt(text)}")
    low, high = int(found[1]), int(found[2] or found[1])
    if high > HIGHEST_CPU:
        raise ValueError(f"the highest CPU is {HIGHEST_CPU}, given {excerpt(text)}")
    if low > high:
        raise ValueError(f"{excerpt(text)} ends before it begins; write {high}-{low}")
    return set(range(low, high + 1))


def _parse_io_priority(value: object) -> IoPriority:
    found = _IO.fullmatch(value) if isinstance(value, str) else None
    if found is None:
        raise ValueError(f"expected {_IO_SHOWN}, given {excerpt(str(value))}")
    if found[1] is None:
        return IoPriority(IoClass.IDLE)
    return IoPriority(IoClass[found[1].upper()], int(found[2] or 4))


def parse_cpu_max(value: object) -> CpuMax:
    text = value.strip() if isinstance(value, str) else ""
    if isinstance(value, int | float) and not isinstance(value, bool):
        raise ValueError(f"a number alone is ambiguous; write {value} % for a share of one CPU")  # noqa: TRY004 - pydantic collects ValueError
    limit = CpuMax(NO_LIMIT)
    if (found := _SHARE.fullmatch(text)) is not None:
        limit = CpuMax(round(float(found[1]) * limit.period / 100))
    elif (pair := _QUOTA.fullmatch(text)) is not None and (pair[1] == "max" or pair[2]):
        quota = NO_LIMIT if pair[1] == "max" else int(pair[1])
        limit = CpuMax(quota, int(pair[2] or limit.period))
    else:
        raise ValueError(f"expected {_CPU_TIME_SHOWN}, given {excerpt(str(value))}")
    if not _LEAST_QUOTA <= limit.period <= _LONGEST_PERIOD:
        raise ValueError("the period, in microseconds, is 1000 to 1000000")
    if limit.quota < _LEAST_QUOTA:
        raise ValueError(
            "the kernel gives no less than 1000 microseconds in a period: at least 1 %, or a "
            "longer period"
        )
    if _HIGHEST_QUOTA < limit.quota < NO_LIMIT:
        raise ValueError("no machine has so many CPUs; write max")
    return limit


def _parse_base_path(value: object) -> str:
    if value == "auto":
        return ""
    text = value if isinstance(value, str) else ""
    if not text.startswith("/") or "\0" in text or ".." in text.split("/"):
        raise ValueError(
            "expected auto, or the folder of a control group, such as /sys/fs/cgroup/play_launch"
        )
    return text.rstrip("/") or "/"


def _whole(least: int, most: int, what: str) -> Callable[[object], float]:
    def parse(value: object) -> float:
        if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
            raise ValueError(f"expected {what}, given {excerpt(str(value))}")
        return value

    return parse


_LimitForm: TypeAlias = "tuple[JsonSchema, Callable[[Any], float]]"
BYTES: Final[_LimitForm] = (
    _SIZE_FORM,
    lambda value: 0 if value in {0, "0"} and value is not False else parse_size(value),
)
SECONDS: Final[_LimitForm] = (_DURATION_FORM, lambda value: math.ceil(parse_duration(value)))
MICROSECONDS: Final[_LimitForm] = (
    _DURATION_FORM,
    lambda value: math.ceil(parse_duration(value) * 1_000_000),
)
NICE: Final[_LimitForm] = (
    _COUNT_FORM,
    lambda value: nice_limit(int(_whole(-20, 19, "a nice value from -20 to 19")(value))),
)
PRIORITY: Final = (_COUNT_FORM, _whole(0, 99, "a priority from 0 to 99"))
COUNT: Final = (_COUNT_FORM, _whole(0, 2**63 - 1, "a number from 0 on"))
"""How limits of setrlimit(2) are written, and how they become what the kernel counts."""


def resource_limit(
    name: str, form: JsonSchema, parse_one: Callable[[object], float]
) -> ValueKind[ResourceLimit]:
    """Return the kind of the limit of this name: one value, or soft:hard."""

    def parse(value: object) -> ResourceLimit:
        parts = [value, value]
        if isinstance(value, str) and ":" in value:
            parts = [_number_or_text(part.strip()) for part in value.split(":", 1)]
        soft, hard = map(_or("unlimited", parse_one), parts)
        if soft > hard:
            raise ValueError("the soft limit, before the colon, is higher than the hard limit")
        return ResourceLimit(name, soft, hard)

    return _parsed(parse, form, {"const": "unlimited"}, _pattern(r"^[^:$]+:[^:]+$"))


def _number_or_text(text: str) -> object:
    return int(text) if re.fullmatch(r"-?[0-9]{1,19}", text, re.ASCII) else text


CPUS: Final = _parsed(
    parse_cpus,
    _substitutable(*_CPU_FORMS, {"type": "array", "minItems": 1, "items": {"anyOf": _CPU_FORMS}}),
)
CPU_MAX: Final = _parsed(
    parse_cpu_max,
    _substitutable(_pattern(r"^\s*([0-9.]+\s*%|max|(max|[0-9]+)\s+[0-9]+)\s*$")),
)
WEIGHT: Final = integer(1, 10_000)
PIDS_MAX: Final = _parsed(
    _or("max", _whole(1, 2**22, f"a number from 1 to {2**22}, or max")), _COUNT_FORM, _MAX_FORM
)
MEMORY_LIMIT: Final = _parsed(_or("max", parse_size), _SIZE_FORM, _MAX_FORM)
GROUP_PATH: Final = _parsed(_parse_base_path, _substitutable({"const": "auto"}, _pattern("^/")))
IO_PRIORITY: Final = _parsed(
    _parse_io_priority,
    _substitutable(_pattern(r"^(idle|(best_effort|realtime)(:[0-7])?)$")),
)
