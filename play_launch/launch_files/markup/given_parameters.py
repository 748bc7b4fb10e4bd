"""Parameters as nodes are given them: by `param`, `set_parameter` and files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import yaml

from play_launch.config.model import ParameterType, ParameterValue
from play_launch.launch_files.markup.template import parse
from play_launch.launch_files.markup.trouble import Trouble
from play_launch.launch_files.markup.typing_rules import (
    SCALARS,
    TYPES,
    coerced,
    is_allowed,
    uniform,
)
from play_launch.launch_files.parameter_text import ParameterTextError, read_sections, read_values
from play_launch.launch_files.reading import UnreadableError, text_of
from play_launch.launch_files.records import ParameterFile, Values, parameter

if TYPE_CHECKING:
    from play_launch.launch_files.markup.context import Context
    from play_launch.launch_files.markup.entity import Entity
    from play_launch.launch_files.records import Parameter, Source

Plain: TypeAlias = dict[str, Any]
"""Parameters as values of Python, before they are evaluated."""


def given(entity: Entity, context: Context) -> list[Plain | ParameterFile]:
    """Return what the `param` of a node give, in their order."""
    found: list[Plain | ParameterFile] = []
    for each in entity.nested("param"):
        try:
            found.append(_one(each, context))
        except Trouble as trouble:
            raise Trouble(str(trouble), trouble.place or each.place) from trouble
    return found


def _one(entity: Entity, context: Context) -> Plain | ParameterFile:
    attributes = entity.attributes
    if "from" in attributes:
        if "name" in attributes:
            raise Trouble("give either name or from")
        return _file(context.text(attributes["from"]), attributes.get("allow_substs"), context)
    if "name" not in attributes:
        raise Trouble("param needs the attribute name or from")
    if "allow_substs" in attributes:
        raise Trouble("allow_substs goes with from only")
    values: Plain = {}
    _add(entity, "", values, context)
    return values


def _file(path: str, allow: Any, context: Context) -> ParameterFile:
    if not isinstance(allow, bool):
        allow = bool(coerced(context.text(allow), (bool, False))) if allow else False
    if not allow:
        return ParameterFile(str(Path(path).absolute()))
    try:
        text = text_of(path)
    except UnreadableError as error:
        raise Trouble(f"the parameter file {path}: {error}") from error
    return ParameterFile(str(Path(path).absolute()), context.text(text))


def _add(entity: Entity, prefix: str, values: Plain, context: Context) -> None:
    attributes = entity.attributes
    if "name" not in attributes:
        raise Trouble("param needs the attribute name", entity.place)
    name = prefix + context.text(attributes["name"])
    nested = list(entity.nested("param"))
    kind_name = attributes.get("type")
    if kind_name is not None and kind_name not in TYPES:
        raise Trouble(f"{kind_name} is none of the types {', '.join(TYPES)}", entity.place)
    if "value" in attributes:
        if nested:
            raise Trouble("give either value or nested param", entity.place)
        values[name] = _value(entity, TYPES.get(kind_name or "yaml"), context)
    elif nested and kind_name is None:
        for each in nested:
            _add(each, f"{name}.", values, context)
    else:
        raise Trouble("give value, or nested param without type", entity.place)


def _value(entity: Entity, kind: tuple[type, bool] | None, context: Context) -> Any:
    value = entity.attributes["value"]
    if not entity.is_typed:
        separator = entity.attributes.get("value-sep")
        if separator:
            item = None if kind is None else (kind[0], False)
            value = [coerced(each, item, can_be_text=True) for each in value.split(separator)]
            if not is_allowed(value, can_be_text=True):
                raise Trouble(f"{value} have more than one type")
        else:
            value = coerced(value, kind, can_be_text=True)
    elif not is_allowed(value, can_be_text=True):
        raise Trouble(f"{value!r} is neither a value nor a list of values of one type")
    if isinstance(value, list):
        item = None if kind is None else (kind[0], False)
        made = [_performed(each, item, context) for each in value]
        if not is_allowed(made):
            raise Trouble(f"{made} is no list of values of one type")
        return _checked(made, kind)
    return _checked(_performed(value, kind, context), kind)


def _performed(value: Any, kind: tuple[type, bool] | None, context: Context) -> Any:
    if not isinstance(value, str):
        return value
    template = parse(value)
    if len(template) == 1 and isinstance(template[0], str):
        # Written as it is: a text stays one.
        return template[0]
    return coerced(context.carried_out(template), kind)


def _checked(value: Any, kind: tuple[type, bool] | None) -> Any:
    if kind is not None:
        wanted, is_list = kind
        items = value if isinstance(value, list) else [value]
        if isinstance(value, list) is not is_list or not all(
            isinstance(each, wanted) for each in items
        ):
            raise Trouble(f"{value!r} is no {'list of ' * is_list}{wanted.__name__}")
    return value


def global_value(text: str, name: str) -> Any:
    """Return the value that `set_parameter` gives: YAML 1.1, as launch_ros evaluates it."""
    try:
        value = yaml.safe_load(text or "''")
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise Trouble(f"the value of the parameter {name} is not YAML: {text!r}") from error
    if isinstance(value, list):
        return uniform(value, name)
    if not isinstance(value, SCALARS):
        raise Trouble(f"the parameter {name} has no usable value: {text!r}")
    return value


def global_sources(context: Context) -> list[Source]:
    """Return the parameters for all nodes, as a process gets them: by `-p` and `--params-file`."""
    found: list[Source] = []
    for each in context.configurations.get("global_params", []):
        if isinstance(each, tuple):
            name, value = each
            try:
                # As text, typed again by rcl: a list of Python becomes a text.
                found.append(Values(tuple(read_values(name, f"{value}"))))
            except ParameterTextError as error:
                raise Trouble(f"the parameter {name}: {error}") from error
        else:
            path = Path(each).absolute()
            if not path.is_file():
                raise Trouble(f"the parameter file {path} for all nodes is not there")
            found.append(ParameterFile(str(path)))
    return found


def process_source(values: Plain, pattern: str, where: str, context: Context) -> Source:
    """Return values as a process gets them: launch_ros writes a file, and rcl reads it."""
    text = yaml.dump({pattern: {"ros__parameters": values}}, default_flow_style=False)
    try:
        sections = read_sections(text)
    except ParameterTextError as error:
        context.losses.note(where, f"rcl refuses what launch_ros writes for it: {error}")
        return Values(typed(values), pattern)
    return Values(tuple(each for section in sections for each in section.parameters), pattern)


def typed(values: Plain) -> tuple[Parameter, ...]:
    """Return values with the types that rclpy takes them for."""
    return tuple(parameter(name, _typed(name, value)) for name, value in values.items())


_ONE: dict[type, ParameterType] = {
    bool: ParameterType.BOOL,
    int: ParameterType.INTEGER,
    float: ParameterType.DOUBLE,
    str: ParameterType.STRING,
}
_MANY: dict[type, ParameterType] = {
    bool: ParameterType.BOOL_ARRAY,
    int: ParameterType.INTEGER_ARRAY,
    float: ParameterType.DOUBLE_ARRAY,
    str: ParameterType.STRING_ARRAY,
}


def _typed(name: str, value: Any) -> ParameterValue:
    if isinstance(value, list | tuple):
        kind = type(value[0]) if value else str
        if kind not in _MANY or not all(isinstance(each, kind) for each in value):
            raise Trouble(f"the parameter {name} is no list of values of one type")
        return ParameterValue(_MANY[kind], tuple(value))
    if isinstance(value, bytes):
        return ParameterValue(ParameterType.BYTE_ARRAY, value)
    if type(value) not in _ONE:
        raise Trouble(f"the parameter {name} has no usable value: {value!r}")
    return ParameterValue(_ONE[type(value)], value)


def component_file(source: ParameterFile, full_name: str) -> Plain:
    """Return what launch_ros finds in a file for a composable node.

    It reads YAML 1.1 by PyYAML, and takes `/**` and the exact name only; a file without sections
    is taken as it is.
    """
    try:
        tree = yaml.safe_load(text_of(source.path) if source.text is None else source.text)
    except UnreadableError as error:
        raise Trouble(f"the parameter file {source.path}: {error}") from error
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise Trouble(f"the parameter file {source.path} is not YAML: {error}") from error
    if not isinstance(tree, dict):
        return {}
    sections: dict[str, Any] = {}
    _collect(tree, [], sections)
    found = dict(tree)
    if sections:
        found = dict(sections.get("**") or {}) | dict(sections.get(full_name.strip("/")) or {})
    return flattened(found)


def _collect(tree: dict[Any, Any], keys: list[str], sections: dict[str, Any]) -> None:
    for key, value in tree.items():
        if key == "ros__parameters":
            sections["/".join(keys)] = value
            return
        if isinstance(value, dict):
            _collect(value, [*keys, str(key).lstrip("/")], sections)


def flattened(values: dict[Any, Any], prefix: str = "") -> Plain:
    """Return nested parameters with their names joined by dots."""
    found: Plain = {}
    for key, value in values.items():
        if isinstance(value, dict):
            found |= flattened(value, f"{prefix}{key}.")
        elif isinstance(value, list) and {type(each) for each in value} == {int, float}:
            found[f"{prefix}{key}"] = [float(each) for each in value]
        else:
            found[f"{prefix}{key}"] = value
    return found


def extra_arguments(entity: Entity, context: Context) -> tuple[Parameter, ...]:
    """Return the `extra_arg` of a composable node."""
    values = {}
    for each in entity.nested("extra_arg"):
        name = context.text(each.attributes["name"])
        values[name] = global_value(context.text(each.attributes["value"]), name)
    return typed(values)
