"""The kinds of values that keys of the configuration take, as schemas of pydantic's core."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any, Final, TypeVar

from pydantic_core import core_schema

from play_launch.config.problems import excerpt
from play_launch.config.resource_values import (
    LIMIT_FORMS,
    limit_parser,
    parse_base_path,
    parse_cpu_max,
    parse_cpus,
    parse_io_priority,
    parse_memory,
    parse_pids_max,
)
from play_launch.config.values import (
    NEVER,
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
    from collections.abc import Callable
    from enum import StrEnum

    from pydantic_core import CoreSchema

LOG_LEVELS = ("debug", "info", "warn", "error", "fatal")
SHORTEST_SAMPLING_PERIOD: Final = 0.1
"""Seconds; more often, measuring would show in what is measured."""
_LONGEST_RUN_NAME = 150
_PACKAGE_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_-]*", re.ASCII)
_SINGLE_COLON = re.compile(r"(?<!:):(?!:)")
_IDENTITY_RULE = re.compile(r"(?:[^:]*:)?__(?:node|name|ns):=")

_Choice = TypeVar("_Choice", bound="StrEnum")


def _check_text(text: str) -> str:
    if "\x00" in text:
        raise ValueError("a NUL character cannot be handed to a program")
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


def _check_pattern(pattern: str) -> str:
    try:
        re.compile(_check_filled(pattern))
    except re.error as error:
        raise ValueError(f"{excerpt(pattern)} is not a regular expression: {error}") from None
    return pattern


def _check_graph_name(name: str) -> str:
    full_name = name if name.startswith("/") else f"/{name}"
    return check_topic(full_name)


def _parse_sampling_period(value: object) -> float:
    period = parse_duration(value)
    if period < SHORTEST_SAMPLING_PERIOD:
        raise ValueError(
            f"must be at least {SHORTEST_SAMPLING_PERIOD * 1000:g} ms, or never for no samples"
        )
    return period


def _or_never(parse: Callable[[object], float]) -> Callable[[object], float]:
    return lambda value: NEVER if value == "never" else parse(value)


def _one_of(choices: type[StrEnum]) -> str:
    *others, last = choices
    return f"{', '.join(others)} or {last}"


def _parse_choice(value: object, choices: type[_Choice]) -> _Choice:
    if not isinstance(value, str) or value not in set(choices):
        raise ValueError(f"expected {_one_of(choices)}, given {excerpt(str(value))}")
    return choices(value)


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


def _checked(check: Callable[[Any], object], schema: CoreSchema) -> CoreSchema:
    return core_schema.no_info_after_validator_function(check, schema)


def _parsed(parse: Callable[[Any], object], **about: object) -> CoreSchema:
    """Check by a function; `about` says for editors which form it takes."""
    return core_schema.no_info_plain_validator_function(parse, metadata=about)


def _text(check: Callable[[str], str]) -> CoreSchema:
    return _checked(check, core_schema.str_schema(strict=True))


def integer(least: int, most: int) -> CoreSchema:
    """Give a schema of integers from ``least`` to ``most``."""
    return core_schema.int_schema(strict=True, ge=least, le=most)


def list_of(items: CoreSchema, *, least: int | None = None) -> CoreSchema:
    """Give a schema of lists with at least so many items."""
    return core_schema.list_schema(items, strict=True, min_length=least)


def choice(choices: type[_Choice]) -> CoreSchema:
    """Give a schema of the values of an enumeration."""
    return _parsed(lambda value: _parse_choice(value, choices), choices=choices)


def resource_limit(name: str) -> CoreSchema:
    """Give a schema of the limit of that name, see setrlimit(2)."""
    shape = f"{LIMIT_FORMS[name].shape} or unlimited or pair"
    return _parsed(limit_parser(name), shape=shape)


BOOLEAN: Final = core_schema.bool_schema(strict=True)
THREADS: Final = integer(1, 1024)
DURATION: Final = _parsed(parse_duration, shape="duration")
POSITIVE_DURATION: Final = _parsed(parse_positive_duration, shape="duration")
POSITIVE_DURATION_OR_NEVER: Final = _parsed(
    _or_never(parse_positive_duration), shape="duration or never"
)
SAMPLING_PERIOD: Final = _parsed(_or_never(_parse_sampling_period), shape="duration or never")
SIZE: Final = _parsed(parse_size, shape="size")
SIZE_OR_NEVER: Final = _parsed(_or_never(parse_size), shape="size or never")
CPUS: Final = _parsed(parse_cpus, shape="cpus")
CPU_MAX: Final = _parsed(parse_cpu_max, shape="cpu_max")
WEIGHT: Final = integer(1, 10_000)
PIDS_MAX: Final = _parsed(parse_pids_max, shape="count or max")
MEMORY_LIMIT: Final = _parsed(parse_memory, shape="size or max")
GROUP_PATH: Final = _parsed(parse_base_path, shape="group_path")
IO_PRIORITY: Final = _parsed(parse_io_priority, shape="io_priority")
LOG_LEVEL: Final = _parsed(_parse_log_level, choices=LOG_LEVELS, upper_case=True)
TEXT: Final = _text(_check_text)
FILLED_TEXT: Final = _text(_check_filled)
PREFIX: Final = _parsed(parse_prefix, shape="words")
COMMAND: Final = _checked(_check_command, list_of(TEXT, least=1))
PACKAGE: Final = _text(_check_package)
EXECUTABLE: Final = _text(_check_executable)
NODE_NAME: Final = _text(check_node_name)
NAMESPACE: Final = _text(check_namespace)
TOPIC_PATTERN: Final = _text(check_topic_pattern)
TOPIC_PATTERNS: Final = list_of(TOPIC_PATTERN, least=1)
BUDGET: Final = core_schema.no_info_wrap_validator_function(
    _parse_budget, core_schema.dict_schema(TOPIC_PATTERN, SIZE_OR_NEVER, strict=True)
)
# An empty name is the component's own, as in ROS's launch API.
OWN_NODE_NAME: Final = _text(lambda name: check_node_name(name) if name else name)
RUN_NAME: Final = _text(_check_run_name)
PLUGIN: Final = _text(_check_plugin)
ROS_ARGUMENTS: Final = list_of(_text(_check_ros_argument))
VERSION: Final = _checked(_check_version, core_schema.int_schema(strict=True))
PATTERN: Final = _text(_check_pattern)
GRAPH_NAME: Final = _text(_check_graph_name)
