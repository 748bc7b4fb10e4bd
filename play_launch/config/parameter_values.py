"""The type of a parameter, decided from how its value is written."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from play_launch.config.model import ParameterType, ParameterValue
from play_launch.config.problems import excerpt
from play_launch.config.yaml_scalars import ScalarKind
from play_launch.config.yaml_tree import Mapping, Node, Scalar, Sequence, describe_node

if TYPE_CHECKING:
    from play_launch.config.report import Report

_SMALLEST_INTEGER = -(2**63)
_LARGEST_INTEGER = 2**63 - 1

# Strings in YAML 1.2, booleans to ROS's own parser of parameter files, which reads YAML 1.1.
# Either reading would surprise somebody, so neither is taken.
_TRUE_IN_YAML_1_1 = frozenset({"y", "Y", "yes", "Yes", "YES", "on", "On", "ON"})
_FALSE_IN_YAML_1_1 = frozenset({"n", "N", "no", "No", "NO", "off", "Off", "OFF"})
_OCTAL_IN_YAML_1_1 = re.compile(r"[-+]?0[0-9]+", re.ASCII)

_TYPE_OF_KIND = {
    ScalarKind.BOOL: ParameterType.BOOL,
    ScalarKind.INTEGER: ParameterType.INTEGER,
    ScalarKind.FLOAT: ParameterType.DOUBLE,
    ScalarKind.STRING: ParameterType.STRING,
}
_ARRAY_OF = {
    ScalarKind.BOOL: ParameterType.BOOL_ARRAY,
    ScalarKind.INTEGER: ParameterType.INTEGER_ARRAY,
    ScalarKind.FLOAT: ParameterType.DOUBLE_ARRAY,
    ScalarKind.STRING: ParameterType.STRING_ARRAY,
}
_TAGGED_ARRAY = {
    "!bool_array": (ParameterType.BOOL_ARRAY, frozenset({ScalarKind.BOOL})),
    "!integer_array": (ParameterType.INTEGER_ARRAY, frozenset({ScalarKind.INTEGER})),
    "!double_array": (
        ParameterType.DOUBLE_ARRAY,
        frozenset({ScalarKind.FLOAT, ScalarKind.INTEGER}),
    ),
    "!string_array": (ParameterType.STRING_ARRAY, frozenset({ScalarKind.STRING})),
    "!byte_array": (ParameterType.BYTE_ARRAY, frozenset({ScalarKind.INTEGER})),
}


def parameter_value(node: Node, path: str, report: Report) -> ParameterValue | None:
    """Return the typed value at `node`, a scalar or a list; None where a problem was reported."""
    if isinstance(node, Sequence):
        return _array(node, path, report)
    if isinstance(node, Mapping):
        report.add(node.place, path, "expected a value or a list of values, given a mapping")
        return None
    if not _usable(node, path, report):
        return None
    if isinstance(node.value, bytes):
        return ParameterValue(ParameterType.BYTE_ARRAY, node.value)
    if node.value is None:
        return None
    return ParameterValue(_TYPE_OF_KIND[node.kind], node.value)


def _array(node: Sequence, path: str, report: Report) -> ParameterValue | None:
    items = _usable_items(node, path, report)
    if items is None:
        return None
    if node.array_tag is not None:
        return _tagged_array(node, items, path, report)
    if not items:
        report.add(
            node.place,
            path,
            "an empty list has no type; write it with one, for example !string_array [] (also "
            "!bool_array, !integer_array, !double_array, !byte_array), or remove the parameter",
        )
        return None
    kinds = {item.kind for item in items}
    if kinds == {ScalarKind.INTEGER, ScalarKind.FLOAT}:
        report.add(
            node.place,
            path,
            "a list of integers and doubles; write every element as a double (1.0), "
            "or put !double_array before the list",
        )
        return None
    if len(kinds) > 1 or ScalarKind.BINARY in kinds:
        odd = next((item for item in items if item.kind is not items[0].kind), items[0])
        report.add(
            odd.place,
            path,
            "the elements of a list must have one type; the first is "
            f"{describe_node(items[0])}, this is {describe_node(odd)}",
        )
        return None
    return _make_array(_ARRAY_OF[items[0].kind], items)


def _usable_items(node: Sequence, path: str, report: Report) -> list[Scalar] | None:
    before = len(report)
    usable: list[Scalar] = []
    spoiled = False
    for index, item in enumerate(node.items):
        where = f"{path}[{index}]"
        if not isinstance(item, Scalar):
            report.add(
                item.place, where, f"a ROS parameter cannot hold {describe_node(item)} in a list"
            )
        elif _usable(item, where, report):
            usable.append(item)
        else:
            spoiled = True
    return None if spoiled or len(report) > before or len(usable) < len(node.items) else usable


def _tagged_array(
    node: Sequence, items: list[Scalar], path: str, report: Report
) -> ParameterValue | None:
    array_type, allowed = _TAGGED_ARRAY[node.array_tag or ""]
    fits = True
    for index, item in enumerate(items):
        where = f"{path}[{index}]"
        if item.kind not in allowed:
            fits = False
            message = f"{describe_node(item)} does not belong into {node.array_tag}"
            if item.kind is not ScalarKind.BINARY and allowed == {ScalarKind.STRING}:
                message += f"; quote it: {excerpt(item.text)}"
            report.add(item.place, where, message)
        elif array_type is ParameterType.BYTE_ARRAY and not 0 <= _integer(item) <= 255:
            fits = False
            report.add(item.place, where, f"{item.text} is not a byte (0 to 255)")
    return _make_array(array_type, items) if fits else None


def _make_array(array_type: ParameterType, items: list[Scalar]) -> ParameterValue:
    values = [item.value for item in items]
    if array_type is ParameterType.BYTE_ARRAY:
        return ParameterValue(array_type, bytes(_integer(item) for item in items))
    if array_type is ParameterType.BOOL_ARRAY:
        return ParameterValue(array_type, tuple(value is True for value in values))
    if array_type is ParameterType.INTEGER_ARRAY:
        return ParameterValue(array_type, tuple(_integer(item) for item in items))
    if array_type is ParameterType.DOUBLE_ARRAY:
        numbers = (value for value in values if isinstance(value, int | float))
        return ParameterValue(array_type, tuple(float(number) for number in numbers))
    return ParameterValue(array_type, tuple(item.text for item in items))


def _integer(item: Scalar) -> int:
    assert isinstance(item.value, int)
    return item.value


def _usable(node: Scalar, path: str, report: Report) -> bool:
    """Say whether the scalar may be a parameter's value at all, and report why if not."""
    if node.kind is ScalarKind.INVALID:
        return False
    if node.kind is ScalarKind.INTEGER:
        if not _SMALLEST_INTEGER <= _integer(node) <= _LARGEST_INTEGER:
            message = f"{excerpt(node.text)[1:-1]} does not fit into a 64-bit integer"
            report.add(node.place, path, f"{message}; write it with .0 for a double")
            return False
        if node.plain and _OCTAL_IN_YAML_1_1.fullmatch(node.text):
            report.add(node.place, path, _leading_zero(node.text))
            return False
    if node.kind is ScalarKind.STRING:
        if node.plain and node.text in _TRUE_IN_YAML_1_1 | _FALSE_IN_YAML_1_1:
            meant = "true" if node.text in _TRUE_IN_YAML_1_1 else "false"
            report.add(
                node.place,
                path,
                f"{node.text} is a boolean to YAML 1.1 and a string to YAML 1.2; "
                f'write {meant} or "{node.text}"',
            )
            return False
        if "\x00" in node.text:
            report.add(node.place, path, "a string parameter cannot hold a NUL character")
            return False
    return True


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
