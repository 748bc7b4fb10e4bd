"""The keys of the configuration file: one section for each kind of mapping in it.

Raw keys get the YAML node instead of a value, because what stands there (parameters,
remappings, environment, nested lists) is looked at elsewhere, with places at hand.
Absent keys are None here; defaults are filled in when the section is resolved.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any, ClassVar, Final, TypeVar

from pydantic_core import core_schema

from play_launch.config.model import ContainerType, Isolation
from play_launch.config.problems import excerpt
from play_launch.config.section import Section, nested, optional, raw, required
from play_launch.config.values import (
    check_namespace,
    check_node_name,
    parse_duration,
    parse_positive_duration,
)
from play_launch.core.crash import OnCrash

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from enum import StrEnum

    from pydantic_core import CoreSchema

LOG_LEVELS = ("debug", "info", "warn", "error", "fatal")
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


def _checked(check: Callable[[Any], object], schema: CoreSchema) -> CoreSchema:
    return core_schema.no_info_after_validator_function(check, schema)


def _parsed(parse: Callable[[Any], object]) -> CoreSchema:
    return core_schema.no_info_plain_validator_function(parse)


def _text(check: Callable[[str], str]) -> CoreSchema:
    return _checked(check, core_schema.str_schema(strict=True))


def _integer(least: int, most: int) -> CoreSchema:
    return core_schema.int_schema(strict=True, ge=least, le=most)


def _list(items: CoreSchema, *, least: int | None = None) -> CoreSchema:
    return core_schema.list_schema(items, strict=True, min_length=least)


def _choice(choices: type[_Choice]) -> CoreSchema:
    return _parsed(lambda value: _parse_choice(value, choices))


_BOOLEAN: Final = core_schema.bool_schema(strict=True)
_THREADS: Final = _integer(1, 1024)
_DURATION: Final = _parsed(parse_duration)
_POSITIVE_DURATION: Final = _parsed(parse_positive_duration)
_LOG_LEVEL: Final = _parsed(_parse_log_level)
_TEXT: Final = _text(_check_text)
_FILLED_TEXT: Final = _text(_check_filled)
_COMMAND: Final = _checked(_check_command, _list(_TEXT, least=1))
_PACKAGE: Final = _text(_check_package)
_EXECUTABLE: Final = _text(_check_executable)
_NODE_NAME: Final = _text(check_node_name)
_NAMESPACE: Final = _text(check_namespace)
# An empty name is the component's own, as in ROS's launch API.
_OWN_NODE_NAME: Final = _text(lambda name: check_node_name(name) if name else name)


class BackoffSection(Section):
    """`backoff`: the pause before a restart grows from `initial` to `maximum`."""

    initial: float | None = optional(_POSITIVE_DURATION)
    maximum: float | None = optional(_POSITIVE_DURATION)


class RestartSection(Section):
    """`restart`: at most `max_restarts` times `within` a duration."""

    max_restarts: int | None = optional(_integer(0, 1_000_000))
    within: float | None = optional(_POSITIVE_DURATION)
    backoff: BackoffSection | None = nested(BackoffSection)


class StopSection(Section):
    """`stop`: how long each step of stopping may take."""

    ask: float | None = optional(_DURATION)
    sigint: float | None = optional(_DURATION)
    sigterm: float | None = optional(_DURATION)


class LoadingSection(Section):
    """`composable_node_loading`: what holds for every container that says nothing else."""

    container_type: ContainerType | None = optional(_choice(ContainerType))
    thread_num: int | None = optional(_THREADS)
    isolation: Isolation | None = optional(_choice(Isolation))
    core_dumps: bool | None = optional(_BOOLEAN)
    auto_reload_on_crash: bool | None = optional(_BOOLEAN)
    on_crash: OnCrash | None = optional(_choice(OnCrash))
    loading_timeout: float | None = optional(_POSITIVE_DURATION)
    probe_timeout: float | None = optional(_POSITIVE_DURATION)
    restart: RestartSection | None = nested(RestartSection)


class DocumentSection(Section):
    """The top level of the file."""

    advice: ClassVar[Mapping[str, str]] = {
        "record": "this version records every event; what to record cannot be chosen yet",
        "env": "environment",
        "load_node": "containers",
        "composable_nodes": "they belong into an entry of containers",
    }

    version: int = required(_checked(_check_version, core_schema.int_schema(strict=True)))
    name: str | None = optional(_text(_check_run_name))
    duration: float | None = optional(_POSITIVE_DURATION)
    log_dir: str | None = optional(_FILLED_TEXT)
    graph_daemon: bool | None = optional(_BOOLEAN)
    environment: Any = raw()
    stop: StopSection | None = nested(StopSection)
    composable_node_loading: LoadingSection | None = nested(LoadingSection)
    containers: Any = raw()
    nodes: Any = raw()


_SAME_FOR_ALL = {
    "ns": "namespace",
    "node_name": "name",
    "node_namespace": "namespace",
    "pkg": "package",
    "param": "parameters",
    "params": "parameters",
    "remap": "remappings",
    "remaps": "remappings",
    "env": "environment",
    "additional_env": "environment",
    "ros_args": "ros_arguments",
    "ros_arg": "ros_arguments",
    "exec": "executable",
    "condition": "conditions are not evaluated here; leave the entry out instead",
    "output": "not in this version; leave the key out",
}


class ContainerSection(Section):
    """One entry of `containers`."""

    advice: ClassVar[Mapping[str, str]] = _SAME_FOR_ALL | {
        "composable_node_descriptions": "composable_nodes",
        "nodes": "composable_nodes",
        "args": "arguments",
        "parameters": "give parameters to the composable nodes",
        "remappings": "give remappings to the composable nodes",
        "respawn": "containers always come back; see restart.max_restarts",
    }

    name: str = required(_NODE_NAME)
    namespace: str | None = optional(_NAMESPACE)
    container_type: ContainerType | None = optional(_choice(ContainerType))
    thread_num: int | None = optional(_THREADS)
    isolation: Isolation | None = optional(_choice(Isolation))
    core_dumps: bool | None = optional(_BOOLEAN)
    package: str | None = optional(_PACKAGE)
    executable: str | None = optional(_EXECUTABLE)
    arguments: list[str] | None = optional(_list(_TEXT))
    attach: bool | None = optional(_BOOLEAN)
    auto_reload_on_crash: bool | None = optional(_BOOLEAN)
    on_crash: OnCrash | None = optional(_choice(OnCrash))
    log_level: str | None = optional(_LOG_LEVEL)
    environment: Any = raw()
    ros_arguments: list[str] | None = optional(_list(_text(_check_ros_argument)))
    restart: RestartSection | None = nested(RestartSection)
    loading_timeout: float | None = optional(_POSITIVE_DURATION)
    probe_timeout: float | None = optional(_POSITIVE_DURATION)
    composable_nodes: Any = raw()


class ComposableNodeSection(Section):
    """One entry of `composable_nodes`."""

    advice: ClassVar[Mapping[str, str]] = _SAME_FOR_ALL | {
        "node_plugin": "plugin",
        "class": "plugin",
        "extra_args": "extra_arguments",
        "extra_arg": "extra_arguments",
        "environment": "nodes in one container share its environment; set it there",
        "executable": "a composable node is a class: plugin",
    }

    package: str = required(_PACKAGE)
    plugin: str = required(_text(_check_plugin))
    name: str | None = optional(_OWN_NODE_NAME)
    namespace: str | None = optional(_NAMESPACE)
    parameters: Any = raw()
    remappings: Any = raw()
    extra_arguments: Any = raw()
    log_level: str | None = optional(_LOG_LEVEL)
    auto_reload_on_crash: bool | None = optional(_BOOLEAN)
    on_crash: OnCrash | None = optional(_choice(OnCrash))
    restart: RestartSection | None = nested(RestartSection)


class ProcessSection(Section):
    """One entry of `nodes`."""

    advice: ClassVar[Mapping[str, str]] = _SAME_FOR_ALL | {
        "cmd": "command",
        "args": "arguments",
        "plugin": "a node with a plugin belongs into composable_nodes of a container",
        "respawn_delay": "restart: {backoff: {initial: ...}}",
        "respawn_max_retries": "restart: {max_restarts: ...}",
    }

    command: list[str] | None = optional(_COMMAND)
    package: str | None = optional(_PACKAGE)
    executable: str | None = optional(_EXECUTABLE)
    name: str | None = optional(_OWN_NODE_NAME)
    namespace: str | None = optional(_NAMESPACE)
    parameters: Any = raw()
    remappings: Any = raw()
    arguments: list[str] | None = optional(_list(_TEXT))
    ros_arguments: list[str] | None = optional(_list(_text(_check_ros_argument)))
    environment: Any = raw()
    respawn: bool | None = optional(_BOOLEAN)
    restart: RestartSection | None = nested(RestartSection)
    log_level: str | None = optional(_LOG_LEVEL)
