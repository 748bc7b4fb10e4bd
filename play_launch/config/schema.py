"""The keys of the configuration file: one pydantic model for each kind of mapping in it.

Fields marked `Raw` get the YAML node instead of a value, because what stands there (parameters,
remappings, environment, nested lists) is looked at elsewhere, with places at hand.
Absent keys are None here; defaults are filled in when the model is resolved.
"""

import re
from enum import StrEnum
from typing import Annotated, Any, ClassVar, TypeVar

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field

from play_launch.config.model import ContainerType, Isolation
from play_launch.config.problems import excerpt
from play_launch.config.values import (
    check_namespace,
    check_node_name,
    parse_duration,
    parse_positive_duration,
)
from play_launch.core.crash import OnCrash

LOG_LEVELS = ("debug", "info", "warn", "error", "fatal")
_LONGEST_RUN_NAME = 150
_PACKAGE = re.compile(r"[A-Za-z][A-Za-z0-9_-]*", re.ASCII)
_SINGLE_COLON = re.compile(r"(?<!:):(?!:)")
_IDENTITY_RULE = re.compile(r"(?:[^:]*:)?__(?:node|name|ns):=")


_Choice = TypeVar("_Choice", bound=StrEnum)


class RawNode:
    """Marks a field that takes the YAML node itself."""


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
    if not _PACKAGE.fullmatch(name):
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


Raw = Annotated[Any, RawNode()]
Duration = Annotated[float, BeforeValidator(parse_duration)]
PositiveDuration = Annotated[float, BeforeValidator(parse_positive_duration)]
Text = Annotated[str, AfterValidator(_check_text)]
FilledText = Annotated[str, AfterValidator(_check_filled)]
Executable = Annotated[str, AfterValidator(_check_executable)]
Command = Annotated[list[Text], Field(min_length=1), AfterValidator(_check_command)]
NodeName = Annotated[str, AfterValidator(check_node_name)]
# An empty name is the component's own, as in ROS's launch API.
OwnNodeName = Annotated[str, AfterValidator(lambda name: check_node_name(name) if name else name)]
Namespace = Annotated[str, AfterValidator(check_namespace)]
Package = Annotated[str, AfterValidator(_check_package)]
RosArgument = Annotated[str, AfterValidator(_check_ros_argument)]
LogLevel = Annotated[str, BeforeValidator(_parse_log_level)]
ContainerTypeName = Annotated[
    ContainerType, BeforeValidator(lambda it: _parse_choice(it, ContainerType))
]
IsolationName = Annotated[Isolation, BeforeValidator(lambda it: _parse_choice(it, Isolation))]
OnCrashName = Annotated[OnCrash, BeforeValidator(lambda it: _parse_choice(it, OnCrash))]
ThreadNum = Annotated[int, Field(ge=1, le=1024)]


class Section(BaseModel):
    """A mapping of the configuration; `advice` says what to write instead of some foreign keys."""

    # Built when it is first used: no configuration has all of them.
    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, defer_build=True)
    advice: ClassVar[dict[str, str]] = {}


class BackoffSection(Section):
    """`backoff`: the pause before a restart grows from `initial` to `maximum`."""

    initial: PositiveDuration | None = None
    maximum: PositiveDuration | None = None


class RestartSection(Section):
    """`restart`: at most `max_restarts` times `within` a duration."""

    max_restarts: Annotated[int, Field(ge=0, le=1_000_000)] | None = None
    within: PositiveDuration | None = None
    backoff: BackoffSection | None = None


class StopSection(Section):
    """`stop`: how long each step of stopping may take."""

    ask: Duration | None = None
    sigint: Duration | None = None
    sigterm: Duration | None = None


class LoadingSection(Section):
    """`composable_node_loading`: what holds for every container that says nothing else."""

    container_type: ContainerTypeName | None = None
    thread_num: ThreadNum | None = None
    isolation: IsolationName | None = None
    core_dumps: bool | None = None
    auto_reload_on_crash: bool | None = None
    on_crash: OnCrashName | None = None
    loading_timeout: PositiveDuration | None = None
    probe_timeout: PositiveDuration | None = None
    restart: RestartSection | None = None


class DocumentSection(Section):
    """The top level of the file."""

    advice: ClassVar[dict[str, str]] = {
        "record": "this version records every event; what to record cannot be chosen yet",
        "env": "environment",
        "load_node": "containers",
        "composable_nodes": "they belong into an entry of containers",
    }

    version: Annotated[int, AfterValidator(_check_version)]
    name: Annotated[str, AfterValidator(_check_run_name)] | None = None
    duration: PositiveDuration | None = None
    log_dir: FilledText | None = None
    graph_daemon: bool | None = None
    environment: Raw = None
    stop: StopSection | None = None
    composable_node_loading: LoadingSection | None = None
    containers: Raw = None
    nodes: Raw = None


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

    advice: ClassVar[dict[str, str]] = _SAME_FOR_ALL | {
        "composable_node_descriptions": "composable_nodes",
        "nodes": "composable_nodes",
        "args": "arguments",
        "parameters": "give parameters to the composable nodes",
        "remappings": "give remappings to the composable nodes",
        "respawn": "containers always come back; see restart.max_restarts",
    }

    name: NodeName
    namespace: Namespace | None = None
    container_type: ContainerTypeName | None = None
    thread_num: ThreadNum | None = None
    isolation: IsolationName | None = None
    core_dumps: bool | None = None
    package: Package | None = None
    executable: Executable | None = None
    arguments: list[Text] | None = None
    attach: bool | None = None
    auto_reload_on_crash: bool | None = None
    on_crash: OnCrashName | None = None
    log_level: LogLevel | None = None
    environment: Raw = None
    ros_arguments: list[RosArgument] | None = None
    restart: RestartSection | None = None
    loading_timeout: PositiveDuration | None = None
    probe_timeout: PositiveDuration | None = None
    composable_nodes: Raw = None


class ComposableNodeSection(Section):
    """One entry of `composable_nodes`."""

    advice: ClassVar[dict[str, str]] = _SAME_FOR_ALL | {
        "node_plugin": "plugin",
        "class": "plugin",
        "extra_args": "extra_arguments",
        "extra_arg": "extra_arguments",
        "environment": "nodes in one container share its environment; set it there",
        "executable": "a composable node is a class: plugin",
    }

    package: Package
    plugin: Annotated[str, AfterValidator(_check_plugin)]
    name: OwnNodeName | None = None
    namespace: Namespace | None = None
    parameters: Raw = None
    remappings: Raw = None
    extra_arguments: Raw = None
    log_level: LogLevel | None = None
    auto_reload_on_crash: bool | None = None
    on_crash: OnCrashName | None = None
    restart: RestartSection | None = None


class ProcessSection(Section):
    """One entry of `nodes`."""

    advice: ClassVar[dict[str, str]] = _SAME_FOR_ALL | {
        "cmd": "command",
        "args": "arguments",
        "plugin": "a node with a plugin belongs into composable_nodes of a container",
        "respawn_delay": "restart: {backoff: {initial: ...}}",
        "respawn_max_retries": "restart: {max_restarts: ...}",
    }

    command: Command | None = None
    package: Package | None = None
    executable: Executable | None = None
    name: OwnNodeName | None = None
    namespace: Namespace | None = None
    parameters: Raw = None
    remappings: Raw = None
    arguments: list[Text] | None = None
    ros_arguments: list[RosArgument] | None = None
    environment: Raw = None
    respawn: bool | None = None
    restart: RestartSection | None = None
    log_level: LogLevel | None = None
