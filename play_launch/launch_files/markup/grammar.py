"""Which tags there are, with which attributes; everything else is refused, as launch does."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from msgspec import Struct

from play_launch.launch_files.markup.trouble import Trouble

if TYPE_CHECKING:
    from play_launch.launch_files.markup.entity import Entity


class Tag(Struct, frozen=True):
    """A tag: attributes it needs and may have, tags that may be nested.

    With `has_actions` actions are nested. `typed` are attributes that YAML may give as another type
    than a text.
    """

    required: frozenset[str] = frozenset()
    optional: frozenset[str] = frozenset()
    nested: frozenset[str] = frozenset()
    has_actions: bool = False
    typed: frozenset[str] = frozenset()


def _tag(
    required: str = "",
    optional: str = "",
    nested: str = "",
    typed: str = "",
    *,
    actions: bool = False,
) -> Tag:
    return Tag(
        frozenset(required.split()),
        frozenset((optional + " " + typed).split()) - frozenset(required.split()),
        frozenset(nested.split()),
        actions,
        frozenset(typed.split()),
    )


_IF: Final = " if unless"
_PROCESS: Final = "cwd on_exit launch-prefix output respawn" + _IF
_PROCESS_TYPED: Final = (
    "respawn_max_retries respawn_delay sigkill_timeout sigterm_timeout shell emulate_tty"
)
_NODE: Final = "args ros_args name exec_name pkg namespace " + _PROCESS

ACTIONS: Final = {
    "arg": _tag("name", "default description" + _IF, "choice"),
    "let": _tag("name value", _IF),
    "group": _tag("", _IF, "keep", "scoped forwarding", actions=True),
    "include": _tag("file", _IF, "arg"),
    "set_env": _tag("name value", _IF),
    "unset_env": _tag("name", _IF),
    "append_env": _tag("name value", "separator" + _IF, "", "prepend"),
    "reset_env": _tag("", _IF),
    "reset": _tag("", _IF, "keep"),
    "log": _tag("message", _IF),
    "timer": _tag("period", _IF, "", "period cancel_on_shutdown", actions=True),
    "ros_timer": _tag("period", _IF, "", "period", actions=True),
    "shutdown": _tag("", "reason" + _IF),
    "push_ros_namespace": _tag("namespace", _IF),
    "push-ros-namespace": _tag("namespace", _IF),
    "set_parameter": _tag("name value", _IF),
    "set_parameters_from_file": _tag("filename", _IF),
    "set_remap": _tag("from to", _IF),
    "set_ros_log_dir": _tag("new_log_dir", _IF),
    "set_use_sim_time": _tag("value", _IF),
    "executable": _tag("cmd", "name " + _PROCESS, "env", _PROCESS_TYPED),
    "node": _tag("exec", _NODE, "env param remap", _PROCESS_TYPED),
    "node_container": _tag(
        "exec name namespace", _NODE, "env param remap composable_node", _PROCESS_TYPED
    ),
    "load_composable_node": _tag("target", _IF, "composable_node"),
}
_PARTS: Final = {
    "choice": _tag("value"),
    "keep": _tag("name value"),
    "env": _tag("name value"),
    "remap": _tag("from to"),
    "extra_arg": _tag("name value"),
    "param": _tag("", "name from value-sep", "param", "type value allow_substs"),
    "composable_node": _tag("pkg plugin name", "namespace" + _IF, "param remap extra_arg"),
}
_ARGUMENT_OF_INCLUDE: Final = _tag("name value")


def check(root: Entity) -> None:
    """Check a whole file before anything of it is evaluated.

    Raises:
        Trouble: For the first mistake.
    """
    for child in root.below:
        _check_action(child)


def _check_action(entity: Entity) -> None:
    tag = ACTIONS.get(entity.tag)
    if tag is None:
        raise Trouble(f"launch has no {entity.tag}{_meant(entity.tag, ACTIONS)}", entity.place)
    _check(entity, tag)


def _check(entity: Entity, tag: Tag) -> None:
    given = entity.attributes.keys()
    for missing in sorted(tag.required - given):
        raise Trouble(f"{entity.tag} needs the attribute {missing}", entity.place)
    for key in given:
        if key not in tag.required and key not in tag.optional:
            known = sorted(tag.required | tag.optional)
            raise Trouble(f"{entity.tag} has no attribute {key}{_meant(key, known)}", entity.place)
        value = entity.attributes[key]
        if entity.is_typed and key not in tag.typed and not isinstance(value, str):
            raise Trouble(f"{key} of {entity.tag} is no text; put it in quotes", entity.place)
    if {"if", "unless"} <= given:
        raise Trouble("give either if or unless", entity.place)
    for child in entity.below:
        if child.tag in tag.nested:
            part = _ARGUMENT_OF_INCLUDE if child.tag == "arg" else _PARTS[child.tag]
            _check(child, part)
        elif tag.has_actions:
            _check_action(child)
        else:
            hint = _meant(child.tag, sorted(tag.nested))
            raise Trouble(f"{entity.tag} cannot hold {child.tag}{hint}", child.place)


def _meant(given: str, known: object) -> str:
    import difflib  # noqa: PLC0415 - a good file needs no guesses

    close = difflib.get_close_matches(given, list(known), 1)  # type: ignore[call-overload]
    return f"; did you mean {close[0]}?" if close else ""
