"""Parameters of a node: their sources, of which the later one wins, and their types.

The type of a parameter follows from how its value is written.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final

from play_launch.config.model import ParameterConfig, ParameterType, ParameterValue
from play_launch.config.problems import excerpt
from play_launch.config.tree import Mapping, Scalar, ScalarKind, Sequence, describe_node

if TYPE_CHECKING:
    from play_launch.config.problems import Location
    from play_launch.config.resolve.parameter_files import ParameterFileReader
    from play_launch.config.tree import Cursor

KEY_IN_FILES: Final = "ros__parameters"
# Strings in YAML 1.2, booleans to ROS's own parser of parameter files, which reads YAML 1.1.
# Either reading would surprise, so neither is used.
_TRUE_IN_YAML_1_1: Final = frozenset({"y", "Y", "yes", "Yes", "YES", "on", "On", "ON"})
_FALSE_IN_YAML_1_1: Final = frozenset({"n", "N", "no", "No", "NO", "off", "Off", "OFF"})
_OCTAL_IN_YAML_1_1: Final = re.compile(r"[-+]?0[0-9]+", re.ASCII)

_TYPES: Final = {
    ScalarKind.BOOL: (ParameterType.BOOL, ParameterType.BOOL_ARRAY),
    ScalarKind.INTEGER: (ParameterType.INTEGER, ParameterType.INTEGER_ARRAY),
    ScalarKind.FLOAT: (ParameterType.DOUBLE, ParameterType.DOUBLE_ARRAY),
    ScalarKind.STRING: (ParameterType.STRING, ParameterType.STRING_ARRAY),
}
"""The types of a value, and of a list of such values."""
_TAGGED_ARRAY: Final = {
    "!bool_array": (ParameterType.BOOL_ARRAY, {ScalarKind.BOOL}),
    "!integer_array": (ParameterType.INTEGER_ARRAY, {ScalarKind.INTEGER}),
    "!double_array": (ParameterType.DOUBLE_ARRAY, {ScalarKind.FLOAT, ScalarKind.INTEGER}),
    "!string_array": (ParameterType.STRING_ARRAY, {ScalarKind.STRING}),
    "!byte_array": (ParameterType.BYTE_ARRAY, {ScalarKind.INTEGER}),
}


def resolve_parameters(
    at: Cursor | None, *, full_name: str | None, files: ParameterFileReader | None
) -> tuple[ParameterConfig, ...]:
    """Return the parameters from the sources that stand there.

    A source is a mapping or the path of a parameter file; `full_name` (None where the
    configuration does not give it) selects the sections of such a file. `files` is None where
    files are not allowed.
    """
    values: dict[str, ParameterValue] = {}
    if at is None:
        return ()
    if isinstance(at.node, Mapping):
        values.update(flatten(at))
    elif at.is_plain_list:
        for source in at.elements():
            if isinstance(source.node, Mapping):
                values.update(flatten(source))
            elif source.string is not None and files is not None:
                values.update(files.select(source, source.string, full_name))
            else:
                path = "" if files is None else " or the path of a parameter file"
                source.expected(f"a mapping{path}")
    elif not at.is_invalid:
        message = f"expected a mapping or a list of sources, given {describe_node(at.node)}"
        if at.string is not None and files is not None:
            message += "; put the file into a list: [ ... ]"
        at.problem(message)
    return tuple(ParameterConfig(name, value) for name, value in values.items())


def flatten(at: Cursor, *, is_file: bool = False) -> dict[str, ParameterValue]:
    """Return the parameters in a mapping, the names of nested ones joined with dots.

    With `is_file`, those of a parameter file, in which rcl skips empty lists.
    """
    values: dict[str, ParameterValue] = {}
    _flatten_into(at, "", values, {}, is_file=is_file)
    return values


def _flatten_into(
    at: Cursor,
    prefix: str,
    values: dict[str, ParameterValue],
    locations: dict[str, Location],
    *,
    is_file: bool,
) -> None:
    for entry, value in at.entries():
        name = prefix + entry.key
        node = value.node
        if "\x00" in entry.key:
            value.problem("a parameter name cannot hold a NUL character", entry.location)
        elif entry.key == KEY_IN_FILES:
            message = f"{KEY_IN_FILES} belongs into parameter files, above the names"
            value.problem(f"{message}; write the names here directly", entry.location)
        elif isinstance(node, Mapping):
            _flatten_into(value, name + ".", values, locations, is_file=is_file)
        elif name in locations:
            message = f"the parameter {name} is given twice, first at {locations[name]}"
            value.problem(message, entry.location)
        else:
            locations[name] = entry.location
            if is_file and value.is_plain_list and isinstance(node, Sequence) and not node.items:
                continue
            typed = _array(value, node) if isinstance(node, Sequence) else _scalar(value, node)
            if typed is not None:
                values[name] = typed


def _scalar(at: Cursor, node: Scalar) -> ParameterValue | None:
    if not _is_usable(at, node) or node.value is None:
        return None
    if isinstance(node.value, bytes):
        return ParameterValue(ParameterType.BYTE_ARRAY, node.value)
    return ParameterValue(_TYPES[node.kind][0], node.value)


def _array(at: Cursor, node: Sequence) -> ParameterValue | None:
    items: list[Scalar] = []
    for item in at.elements():
        if not isinstance(item.node, Scalar):
            item.problem(f"a ROS parameter cannot hold {describe_node(item.node)} in a list")
        elif _is_usable(item, item.node):
            items.append(item.node)
    if len(items) < len(node.items):
        return None
    if node.array_tag is not None:
        return _tagged_array(at, node.array_tag, items)
    kinds = {item.kind for item in items}
    location = None
    if not items:
        message = (
            "an empty list has no type; write it with one, for example !string_array [] (also "
            "!bool_array, !integer_array, !double_array, !byte_array), or remove the parameter"
        )
    elif kinds == {ScalarKind.INTEGER, ScalarKind.FLOAT}:
        message = (
            "a list of integers and doubles; write every element as a double (1.0), "
            "or put !double_array before the list"
        )
    elif len(kinds) > 1 or ScalarKind.BINARY in kinds:
        odd = next((item for item in items if item.kind is not items[0].kind), items[0])
        location = odd.location
        message = (
            "the elements of a list must have one type; the first is "
            f"{describe_node(items[0])}, this is {describe_node(odd)}"
        )
    else:
        return _made_array(_TYPES[items[0].kind][1], items)
    at.problem(message, location)
    return None


def _tagged_array(at: Cursor, tag: str, items: list[Scalar]) -> ParameterValue | None:
    array_type, allowed = _TAGGED_ARRAY[tag]
    fits = True
    for index, item in enumerate(items):
        message = ""
        if item.kind not in allowed:
            message = f"{describe_node(item)} does not belong into {tag}"
            if item.kind is not ScalarKind.BINARY and allowed == {ScalarKind.STRING}:
                message += f"; quote it: {excerpt(item.text)}"
        elif array_type is ParameterType.BYTE_ARRAY and not 0 <= _integer(item) <= 255:
            message = f"{item.text} is not a byte (0 to 255)"
        if message:
            fits = False
            at.element(index).problem(message)
    return _made_array(array_type, items) if fits else None


def _made_array(array_type: ParameterType, items: list[Scalar]) -> ParameterValue:
    match array_type:
        case ParameterType.BYTE_ARRAY:
            return ParameterValue(array_type, bytes(_integer(item) for item in items))
        case ParameterType.BOOL_ARRAY:
            return ParameterValue(array_type, tuple(item.value is True for item in items))
        case ParameterType.INTEGER_ARRAY:
            return ParameterValue(array_type, tuple(_integer(item) for item in items))
        case ParameterType.DOUBLE_ARRAY:
            numbers = (item.value for item in items if isinstance(item.value, int | float))
            return ParameterValue(array_type, tuple(float(number) for number in numbers))
    return ParameterValue(array_type, tuple(item.text for item in items))


def _integer(item: Scalar) -> int:
    assert isinstance(item.value, int)
    return item.value


def _is_usable(at: Cursor, node: Scalar) -> bool:
    """Return whether the scalar may be a parameter's value; report why not."""
    text = node.text
    problem = ""
    if node.kind is ScalarKind.INTEGER:
        if not -(2**63) <= _integer(node) < 2**63:
            shown = excerpt(text)[1:-1]
            problem = f"{shown} does not fit into a 64-bit integer; write it with .0 for a double"
        elif node.plain and _OCTAL_IN_YAML_1_1.fullmatch(text):
            problem = _leading_zero(text)
    elif node.kind is ScalarKind.STRING:
        if node.plain and text in _TRUE_IN_YAML_1_1 | _FALSE_IN_YAML_1_1:
            meant = "true" if text in _TRUE_IN_YAML_1_1 else "false"
            problem = f"{text} is a boolean to YAML 1.1 and a string to YAML 1.2"
            problem += f'; write {meant} or "{text}"'
        elif "\x00" in text:
            problem = "a string parameter cannot hold a NUL character"
    if problem:
        at.problem(problem)
    return not problem and node.kind is not ScalarKind.INVALID


def _leading_zero(text: str) -> str:
    sign = "-" if text.startswith("-") else ""
    digits = text.lstrip("+-0") or "0"
    shown = excerpt(text)[1:-1]
    if sign or set(digits) & set("89"):
        return f"{shown} has leading zeros; write {sign}{digits}, or quote it if it is a string"
    return (
        f"{shown} is octal to YAML 1.1 and decimal to YAML 1.2; "
        f"write {digits} or 0o{digits}, or quote it if it is a string"
    )
