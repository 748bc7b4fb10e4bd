"""Nodes, containers, composable nodes and commands: what becomes a record."""

from __future__ import annotations

import os
import re
from typing import TYPE_CHECKING, Any

from play_launch.config.model import FOR_ALL
from play_launch.launch_files.markup import given_parameters
from play_launch.launch_files.markup.command_line import split, words_of
from play_launch.launch_files.markup.context import joined_namespace
from play_launch.launch_files.markup.substitutions import executable_in_package
from play_launch.launch_files.markup.trouble import Trouble
from play_launch.launch_files.markup.typing_rules import coerced, condition, truth
from play_launch.launch_files.parameters import evaluate_sources
from play_launch.launch_files.records import (
    OUTPUTS,
    AtExit,
    Composable,
    ParameterFile,
    Process,
    ProgramKind,
    Values,
)

if TYPE_CHECKING:
    from play_launch.launch_files.markup.context import Context
    from play_launch.launch_files.markup.entity import Entity

_NODE_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*", re.ASCII)
_TYPED: dict[str, Any] = {
    "respawn_max_retries": int,
    "respawn_delay": float,
    "sigkill_timeout": float,
    "sigterm_timeout": float,
    "shell": bool,
    "emulate_tty": bool,
}


def executable(entity: Entity, context: Context) -> None:
    """Record a command."""
    words = words_of(entity.attributes["cmd"], context)
    if not words or not words[0]:
        raise Trouble("cmd is empty")
    process = Process(kind=ProgramKind.PROCESS, command=words)
    if "name" in entity.attributes:
        process.label = context.text(entity.attributes["name"])
    _complete(process, words[0], entity, context)
    context.description.units.append(process)


def node(entity: Entity, context: Context) -> None:
    """Record a node."""
    context.description.units.append(_node(entity, ProgramKind.NODE, context))


def node_container(entity: Entity, context: Context) -> None:
    """Record a container and its nodes."""
    wanted = [each for each in entity.nested("composable_node") if is_wanted(each, context)]
    process = _node(entity, ProgramKind.CONTAINER, context)
    context.description.units.append(process)
    for each in wanted:
        # launch_ros looks at the condition again when it loads.
        if is_wanted(each, context):
            _composable(each, process.full_name, context)


def load_composable_node(entity: Entity, context: Context) -> None:
    """Record nodes for a container that is named."""
    target = context.text(entity.attributes["target"])
    for each in entity.nested("composable_node"):
        if is_wanted(each, context):
            _composable(each, target, context)


def is_wanted(entity: Entity, context: Context) -> bool:
    """Return whether the condition of an entity holds; True where it has none."""
    if "if" in entity.attributes:
        return condition(context.text(entity.attributes["if"]))
    if "unless" in entity.attributes:
        return not condition(context.text(entity.attributes["unless"]))
    return True


def _node(entity: Entity, kind: ProgramKind, context: Context) -> Process:
    attributes = entity.attributes
    process = Process(kind=kind)
    program = context.text(attributes["exec"])
    if "pkg" in attributes:
        process.package = context.text(attributes["pkg"])
        process.executable = program
        process.arguments = (
            words_of(attributes.get("args", ""), context) if attributes.get("args") else []
        )
    else:
        arguments = words_of(attributes["args"], context) if attributes.get("args") else []
        process.command = [program, *arguments]
    if attributes.get("ros_args"):
        process.ros_arguments = words_of(attributes["ros_args"], context)
    if "name" in attributes:
        process.name = context.text(attributes["name"])
        if not _NODE_NAME.fullmatch(process.name):
            raise Trouble(f"{process.name!r} is not the name of a node")
    if "exec_name" in attributes:
        process.label = context.text(attributes["exec_name"])
    own = context.text(attributes["namespace"]) if "namespace" in attributes else None
    namespace = joined_namespace(context.configurations.get("ros_namespace"), own)
    process.namespace = namespace or ""
    pattern = process.full_name if process.name and namespace is not None else FOR_ALL
    _complete(process, program, entity, context)
    process.sources = given_parameters.global_sources(context)
    for each in given_parameters.given(entity, context):
        if not isinstance(each, ParameterFile):
            source = given_parameters.process_source(each, pattern, process.described, context)
            process.sources.append(source)
        elif each.text is None and not os.path.isfile(each.path):  # noqa: PTH113 - as launch_ros
            context.losses.note(process.described, f"{each.path} is not there; launch_ros skips it")
        else:
            process.sources.append(each)
    evaluate_sources(process, context.losses)
    process.remappings = _remappings(entity, context)
    if process.command and not process.package:
        # Without a package, name and namespace are arguments like others.
        names = [("__node", process.name), ("__ns", process.namespace)]
        words = [word for name, value in names if value for word in ("-r", f"{name}:={value}")]
        process.command += ["--ros-args", *words, "--"] if words else []
    if process.package and process.package != "rclcpp_components":
        # Containers of ours take the places of those.
        executable_in_package(context, [program, process.package])
    return process


def _complete(process: Process, program: str, entity: Entity, context: Context) -> None:
    """Fill in what all processes have."""
    attributes = entity.attributes
    process.id = context.new_id()
    process.origin = context.origin(entity)
    process.start = list(context.start)
    typed = {key: _typed(entity, key) for key in _TYPED if key in attributes}
    if "cwd" in attributes:
        process.cwd = os.path.abspath(context.text(attributes["cwd"]))  # noqa: PTH100 - of launch
    if attributes.get("on_exit") is not None:
        if attributes["on_exit"] != "shutdown":
            raise Trouble(f"on_exit can only be shutdown, given {attributes['on_exit']}")
        process.on_exit = AtExit.SHUTDOWN
    process.prefix = _prefix(program, entity, context)
    if "output" in attributes:
        process.output = context.text(attributes["output"])
        if process.output not in OUTPUTS:
            raise Trouble(f"{process.output!r} is no output; {', '.join(sorted(OUTPUTS))} are")
    if "respawn" in attributes:
        process.respawn = truth(context.text(attributes["respawn"]))
    process.respawn_delay = typed.get("respawn_delay")
    process.respawn_max_retries = typed.get("respawn_max_retries", -1)
    process.shell = bool(typed.get("shell", False))
    process.emulate_tty = bool(typed.get("emulate_tty", False))
    if "emulate_tty" in context.configurations:
        process.emulate_tty = condition(str(context.configurations["emulate_tty"]))
    process.sigterm_timeout = _timeout("sigterm_timeout", typed, context)
    process.sigkill_timeout = _timeout("sigkill_timeout", typed, context)
    more = {
        context.text(each.attributes["name"]): context.text(each.attributes["value"])
        for each in entity.nested("env")
    }
    process.environment = context.changed(more)
    process.unset = [name for name in context.unset if name not in more]


def _typed(entity: Entity, key: str) -> Any:
    """Return an attribute that is no text; texts that are no such value count as true."""
    kind = _TYPED[key]
    value: Any = entity.attributes[key]
    if isinstance(value, str):
        value = coerced(value, (kind, False), can_be_text=kind is bool)
    if kind is bool:
        # launch does not evaluate substitutions here.
        return bool(value)
    if not isinstance(value, kind | int) or isinstance(value, bool):
        raise Trouble(f"{key} is no {kind.__name__}: {value!r}")
    number = kind(value)
    if kind is float and number < 0:
        raise Trouble(f"{key} cannot be negative: {value}")
    return number


def _timeout(key: str, typed: dict[str, Any], context: Context) -> float | None:
    if key in typed:
        return float(typed[key])
    if key in context.configurations:
        return float(coerced(str(context.configurations[key]), (float, False)))
    return None


def _prefix(program: str, entity: Entity, context: Context) -> list[str]:
    if "launch-prefix" in entity.attributes:
        return split(context.text(entity.attributes["launch-prefix"]))
    words = str(context.configurations.get("launch-prefix", ""))
    only = str(context.configurations.get("launch-prefix-filter", ""))
    try:
        applies = re.match(only, os.path.basename(program)) is not None  # noqa: PTH119 - as launch
    except re.error as error:
        raise Trouble(f"launch-prefix-filter is no regular expression: {error}") from error
    return split(words) if words and applies else []


def _remappings(entity: Entity, context: Context) -> list[tuple[str, str]]:
    return [
        *context.configurations.get("ros_remaps", []),
        *(
            (context.text(each.attributes["from"]), context.text(each.attributes["to"]))
            for each in entity.nested("remap")
        ),
    ]


def _composable(entity: Entity, container: str, context: Context) -> None:
    try:
        context.description.units.append(_made_composable(entity, container, context))
    except Trouble as trouble:
        raise Trouble(str(trouble), trouble.place or entity.place) from trouble


def _made_composable(entity: Entity, container: str, context: Context) -> Composable:
    attributes = entity.attributes
    own = context.text(attributes["namespace"]) if "namespace" in attributes else None
    unit = Composable(
        id=context.new_id(),
        origin=context.origin(entity),
        package=context.text(attributes["pkg"]),
        plugin=context.text(attributes["plugin"]),
        name=context.text(attributes["name"]),
        namespace=joined_namespace(context.configurations.get("ros_namespace"), own) or "",
        container=container,
        remappings=_remappings(entity, context),
        extra_arguments=list(given_parameters.extra_arguments(entity, context)),
        start=list(context.start),
    )
    found: dict[str, Any] = {}
    for each in context.configurations.get("global_params", []):
        if isinstance(each, tuple):
            values = {each[0]: each[1]}
            unit.sources.append(Values(given_parameters.typed(values)))
        else:
            source = ParameterFile(os.path.abspath(each))  # noqa: PTH100 - as launch_ros
            values = given_parameters.component_file(source, unit.full_name)
            unit.sources.append(source)
        found.update(values)
    for item in given_parameters.given(entity, context):
        if isinstance(item, ParameterFile):
            found.update(given_parameters.component_file(item, unit.full_name))
            unit.sources.append(item)
        else:
            found.update(item)
            unit.sources.append(Values(given_parameters.typed(item)))
    # The request holds values: no rcl reads these files.
    unit.parameters = list(given_parameters.typed(found))
    return unit
