"""What the tags of a launch file do."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any, Final

from play_launch.launch_files.log_folder import log_folder
from play_launch.launch_files.markup import programs
from play_launch.launch_files.markup.context import Deferred, joined_namespace
from play_launch.launch_files.markup.entity import read_entity
from play_launch.launch_files.markup.given_parameters import global_value
from play_launch.launch_files.markup.grammar import check
from play_launch.launch_files.markup.template import unescaped
from play_launch.launch_files.markup.trouble import Exceeded, Trouble
from play_launch.launch_files.markup.typing_rules import coerced
from play_launch.launch_files.reading import UnreadableError, text_of
from play_launch.launch_files.records import Argument, Event, StartCondition

if TYPE_CHECKING:
    from collections.abc import Callable

    from play_launch.launch_files.markup.context import Context
    from play_launch.launch_files.markup.entity import Entity

MOST_INCLUDES: Final = 100
"""How deep includes may be nested."""
INSTALL: Final = (
    "is a launch file in Python, which needs ROS's own launch and launch_ros: install "
    "ros-jazzy-launch-ros, or source an installation of ROS 2"
)


def visit(entity: Entity, context: Context) -> None:
    """Carry out an action, and what it leads to.

    Raises:
        Trouble: With a place, and the includes in `context.chain`.
    """
    try:
        context.count_action()
        if not programs.is_wanted(entity, context):
            return
        _ACTIONS[entity.tag](entity, context)
    except Trouble as trouble:
        is_passed_over = context.only_arguments and entity.tag != "group"
        if is_passed_over and not isinstance(trouble, Exceeded):
            return
        if trouble.place is None:
            trouble.place = entity.place
        raise


def include_file(path: str, context: Context, at: Entity | None = None) -> None:
    """Evaluate a launch file in the present scope: an include makes none."""
    location = os.path.abspath(path)  # noqa: PTH100 - links stay as they are, as in launch
    if location.endswith(".py"):
        raise Trouble(INSTALL if location == context.file else f"{location} {INSTALL}")
    if len(context.chain) > MOST_INCLUDES:
        raise Trouble(f"includes are nested deeper than {MOST_INCLUDES}")
    root = _read(location)
    # As in launch, this holds for what follows the include as well.
    context.file, context.directory = location, os.path.dirname(location)  # noqa: PTH120
    if location not in context.description.files:
        context.description.files.append(location)
    if at is not None:
        for each in at.nested("arg"):
            # Evaluated one after the other, when `$(dirname)` is the included file's already.
            name = context.text(each.attributes["name"])
            context.configurations[name] = context.text(each.attributes["value"])
        context.chain = (at.place, *context.chain)
    check(root)
    for child in root.below:
        visit(child, context)
    if at is not None:
        context.chain = context.chain[1:]


def _read(path: str) -> Entity:
    try:
        return read_entity(text_of(path), path)
    except UnreadableError as error:
        raise Trouble(f"the launch file {path}: {error}") from error


def _arg(entity: Entity, context: Context) -> None:
    attributes = entity.attributes
    name = unescaped(attributes["name"])
    choices = tuple(unescaped(each.attributes["value"]) for each in entity.nested("choice"))
    default = attributes.get("default")
    is_new = all(each.name != name for each in context.description.arguments)
    if (is_new and name not in context.configurations) or (name in context.given and is_new):
        context.description.arguments.append(
            Argument(
                name,
                default,
                unescaped(attributes.get("description", "")),
                choices,
                context.origin(entity),
            )
        )
    if name not in context.configurations:
        if default is None:
            raise Trouble(f"the argument {name} is required; give {name}:=value")
        context.configurations[name] = context.text(default)
    value = context.configurations[name]
    if choices and value not in choices:
        raise Trouble(f"{value!r} is none of the choices of {name}: {', '.join(choices)}")


def _let(entity: Entity, context: Context) -> None:
    name = context.text(entity.attributes["name"])
    context.configurations[name] = context.text(entity.attributes["value"])


def _flag(entity: Entity, key: str, default: bool) -> bool:
    value = entity.attributes.get(key, default)
    # A text that is no truth value counts as true: launch evaluates no substitution here.
    return bool(
        coerced(value, (bool, False), can_be_text=True) if isinstance(value, str) else value
    )


def _group(entity: Entity, context: Context) -> None:
    scoped = _flag(entity, "scoped", default=True)
    forwarding = _flag(entity, "forwarding", default=True)
    kept = list(entity.nested("keep"))
    if scoped:
        context.push()
    try:
        if scoped and not forwarding:
            context.environment = dict(context.initial_environment)
            context.configurations = _kept(kept, context)
        else:
            for each in kept:
                _let(each, context)
        for child in entity.below:
            if child.tag != "keep":
                visit(child, context)
    finally:
        if scoped:
            context.pop()


def _kept(kept: list[Entity], context: Context) -> dict[str, Any]:
    return {
        context.text(each.attributes["name"]): context.text(each.attributes["value"])
        for each in kept
    }


def _reset(entity: Entity, context: Context) -> None:
    context.configurations = _kept(list(entity.nested("keep")), context)


def _reset_env(_: Entity, context: Context) -> None:
    context.environment = dict(context.initial_environment)


def _include(entity: Entity, context: Context) -> None:
    include_file(context.text(entity.attributes["file"]), context, entity)


def _set_env(entity: Entity, context: Context) -> None:
    name = context.text(entity.attributes["name"])
    context.environment[name] = context.text(entity.attributes["value"])


def _unset_env(entity: Entity, context: Context) -> None:
    context.environment.pop(context.text(entity.attributes["name"]), None)


def _append_env(entity: Entity, context: Context) -> None:
    name = context.text(entity.attributes["name"])
    value = context.text(entity.attributes["value"])
    prepend = entity.attributes.get("prepend", False)
    if isinstance(prepend, str):
        prepend = coerced(context.text(prepend), (bool, False))
    separator = context.text(entity.attributes.get("separator", os.pathsep))
    if name in context.environment:
        pair = (context.environment[name], value)
        value = separator.join(reversed(pair) if prepend else pair)
    context.environment[name] = value


def _log(entity: Entity, context: Context) -> None:
    where = str(context.origin(entity))
    context.losses.note(where, f"log: {context.text(entity.attributes['message'])}")


def _timer(entity: Entity, context: Context) -> None:
    period = entity.attributes["period"]
    if isinstance(period, str):
        period = coerced(context.text(period), (float, False))
    elif isinstance(period, bool) or not isinstance(period, int | float):
        raise Trouble(f"period is no number: {period!r}")
    where = str(context.origin(entity))
    if entity.tag == "ros_timer":
        context.losses.lost(where, "ros_timer: it counts the time of the machine, not that of ROS")
    if not _cancels(entity, context):
        what = "cancel_on_shutdown: nothing is started any more while the system is shut down"
        context.losses.note(where, what)
    delay = StartCondition(event=Event.DELAY, seconds=max(0.0, float(period)))
    context.deferred.append(
        Deferred(
            entity.below,
            context.chain,
            context.file,
            context.directory,
            (*context.start, delay),
        )
    )


def _cancels(entity: Entity, context: Context) -> bool:
    value = entity.attributes.get("cancel_on_shutdown", True)
    if isinstance(value, str):
        value = coerced(context.text(value), (bool, False))
    return bool(value)


def _shutdown(entity: Entity, context: Context) -> None:
    context.losses.lost(str(context.origin(entity)), "shuts everything down when it is reached")


def _push_namespace(entity: Entity, context: Context) -> None:
    pushed = context.text(entity.attributes["namespace"])
    base = context.configurations.get("ros_namespace")
    context.configurations["ros_namespace"] = joined_namespace(base, pushed)


def _set_parameter(entity: Entity, context: Context) -> None:
    name = context.text(entity.attributes["name"])
    value = global_value(context.text(entity.attributes["value"]), name)
    # The list is the same object in all scopes that have one.
    context.configurations.setdefault("global_params", []).append((name, value))


def _set_parameters_from_file(entity: Entity, context: Context) -> None:
    path = context.text(entity.attributes["filename"])
    context.configurations.setdefault("global_params", []).append(path)


def _set_remap(entity: Entity, context: Context) -> None:
    pair = (context.text(entity.attributes["from"]), context.text(entity.attributes["to"]))
    context.configurations.setdefault("ros_remaps", []).append(pair)


def _set_log_dir(entity: Entity, context: Context) -> None:
    folder = context.text(entity.attributes["new_log_dir"])
    present = log_folder(context.environment)
    context.environment["ROS_LOG_DIR"] = os.path.join(present, folder)  # noqa: PTH118 - as launch_ros


def _set_sim_time(entity: Entity, context: Context) -> None:
    # It is about the node of launch itself, which there is none of here.
    context.text(entity.attributes["value"])


_ACTIONS: Final[dict[str, Callable[[Entity, Context], None]]] = {
    "arg": _arg,
    "let": _let,
    "group": _group,
    "include": _include,
    "set_env": _set_env,
    "unset_env": _unset_env,
    "append_env": _append_env,
    "reset_env": _reset_env,
    "reset": _reset,
    "log": _log,
    "timer": _timer,
    "ros_timer": _timer,
    "shutdown": _shutdown,
    "push_ros_namespace": _push_namespace,
    "push-ros-namespace": _push_namespace,
    "set_parameter": _set_parameter,
    "set_parameters_from_file": _set_parameters_from_file,
    "set_remap": _set_remap,
    "set_ros_log_dir": _set_log_dir,
    "set_use_sim_time": _set_sim_time,
    "executable": programs.executable,
    "node": programs.node,
    "node_container": programs.node_container,
    "load_composable_node": programs.load_composable_node,
}
