"""Parameters of a node, evaluated from their sources as its process does it.

As in rcl, a section counts where it is mentioned first, and within it the later value wins. So a
value that is given last may lose to one of an earlier file that names the node. Types follow
`rcl_yaml_param_parser` (`parse.c`) of ROS 2 Jazzy, not YAML: `010` is 8, `yes` is true, `null` is
a string, `[1, 2.5]` is refused.
"""

from __future__ import annotations

import re
import sys
from typing import TYPE_CHECKING, Final

import yaml

from play_launch.config.model import FOR_ALL, ParameterType, ParameterValue
from play_launch.config.resolve.parameter_files import matches
from play_launch.launch_files.find import UnreadableError, text_of
from play_launch.launch_files.records import LaunchedProcess, Parameter, Section, Values, parameter

if TYPE_CHECKING:
    from collections.abc import Iterable

    from play_launch.launch_files.records import Losses, ParameterFile, Unit

_KEY: Final = "ros__parameters"
_TRUE: Final = frozenset("Y y yes Yes YES true True TRUE on On ON".split())  # noqa: SIM905
_FALSE: Final = frozenset("N n no No NO false False FALSE off Off OFF".split())  # noqa: SIM905
_INTEGER: Final = re.compile(r"[-+]?(?:0[xX][0-9a-fA-F]+|0[0-7]*|[1-9][0-9]*)", re.ASCII)
_DOUBLE: Final = re.compile(
    r"[-+]?(?:(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?|inf|infinity|nan)",
    re.ASCII | re.IGNORECASE,
)
_HEX_DOUBLE: Final = re.compile(
    r"[-+]?0[xX](?:[0-9a-fA-F]+\.?[0-9a-fA-F]*|\.[0-9a-fA-F]+)(?:[pP][-+]?[0-9]+)?", re.ASCII
)
_DOTTED: Final = re.compile(r"([-+]?)\.(inf|Inf|INF|nan|NaN|NAN)")
_ARRAYS: Final = {
    ParameterType.BOOL: ParameterType.BOOL_ARRAY,
    ParameterType.INTEGER: ParameterType.INTEGER_ARRAY,
    ParameterType.DOUBLE: ParameterType.DOUBLE_ARRAY,
    ParameterType.STRING: ParameterType.STRING_ARRAY,
}
_MOST_LEVELS: Final = 100
_Loader: Final = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


class ParameterTextError(ValueError):
    """rcl would refuse the text; `line` is counted from 1, 0 where it is not known."""

    def __init__(self, message: str, line: int = 0) -> None:
        super().__init__(message)
        self.line = line


def read_sections(text: str) -> list[Section]:
    """Return the sections of a parameter file, those of one pattern put together.

    Raises:
        ParameterTextError: When rcl refuses the file.
    """
    found: dict[str, dict[str, Parameter]] = {}
    root = _composed(text)
    if root is not None:
        if not isinstance(root, yaml.MappingNode):
            raise _wrong("expected names of nodes", root)
        _collect(root, "", found, 0)
    return [Section(pattern, tuple(values.values())) for pattern, values in found.items()]


def _composed(text: str) -> yaml.Node | None:
    try:
        root: yaml.Node | None = yaml.compose(text, Loader=_Loader)
    except yaml.MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark is not None else 0
        raise ParameterTextError(error.problem or "is not YAML", line) from error
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise ParameterTextError("is not YAML") from error
    return root


def _collect(
    node: yaml.MappingNode, pattern: str, found: dict[str, dict[str, Parameter]], level: int
) -> None:
    if level > _MOST_LEVELS:
        raise _wrong("nested too deeply", node)
    for key, value in node.value:
        if not isinstance(key, yaml.ScalarNode):
            raise _wrong("expected a name", key)
        if key.value == _KEY:
            if not pattern or not isinstance(value, yaml.MappingNode):
                raise _wrong(f"{_KEY} stands below the name of a node, above a mapping", key)
            section = found.setdefault(pattern, {})
            for name, below in value.value:
                _take(_name(name), below, section, level)
        elif isinstance(value, yaml.MappingNode):
            _collect(value, f"{pattern}/{key.value.strip('/')}", found, level + 1)
        else:
            raise _wrong(f"expected {_KEY} below {key.value}", value)


def _name(node: yaml.Node) -> str:
    if not isinstance(node, yaml.ScalarNode):
        raise _wrong("expected the name of a parameter", node)
    return str(node.value)


def _take(name: str, node: yaml.Node, found: dict[str, Parameter], level: int) -> None:
    if level > _MOST_LEVELS:
        raise _wrong("nested too deeply", node)
    if isinstance(node, yaml.MappingNode):
        for key, below in node.value:
            _take(f"{name}.{_name(key)}", below, found, level + 1)
    elif isinstance(node, yaml.SequenceNode):
        found[name] = parameter(name, _array(name, node))
    else:
        found[name] = parameter(name, _scalar(name, node))


def _array(name: str, node: yaml.SequenceNode) -> ParameterValue:
    items = [_scalar(name, item) for item in node.value]
    kinds = {item.type for item in items}
    if not items:
        raise _wrong(f"the parameter {name} is an empty list, which has no type", node)
    if len(kinds) > 1:
        raise _wrong(f"the elements of the parameter {name} have more than one type", node)
    values = tuple(item.value for item in items)
    return ParameterValue(_ARRAYS[items[0].type], values)  # type: ignore[arg-type] # of one type


def _scalar(name: str, node: yaml.Node) -> ParameterValue:
    if not isinstance(node, yaml.ScalarNode):
        raise _wrong(f"the parameter {name} is nested too deeply in a list", node)
    if node.style in ("'", '"'):
        return ParameterValue(ParameterType.STRING, node.value)
    if not node.value:
        raise _wrong(f"the parameter {name} has no value", node)
    return typed(node.value)


def typed(text: str) -> ParameterValue:
    """Return the value of an unquoted text."""
    if text in _TRUE or text in _FALSE:
        return ParameterValue(ParameterType.BOOL, text in _TRUE)
    if _INTEGER.fullmatch(text):
        number = _integer(text)
        if -(2**63) <= number < 2**63:
            return ParameterValue(ParameterType.INTEGER, number)
    double = _double(text)
    if double is not None:
        return ParameterValue(ParameterType.DOUBLE, double)
    return ParameterValue(ParameterType.STRING, text)


def _integer(text: str) -> int:
    digits = text.lstrip("+-")
    base = 16 if digits[:2] in ("0x", "0X") else 8 if digits[0] == "0" else 10
    return int(digits, base) * (-1 if text[0] == "-" else 1)


def _double(text: str) -> float | None:
    dotted = _DOTTED.fullmatch(text)
    if dotted:
        return float(dotted[1] + dotted[2])
    if _HEX_DOUBLE.fullmatch(text):
        try:
            return float.fromhex(text)
        except OverflowError:
            return None
    if not _DOUBLE.fullmatch(text):
        return None
    value = float(text)
    # strtod(3) reports a range error for what is too large or too near to 0; then it is a string.
    is_infinite = value in (float("inf"), float("-inf")) and not text.lstrip("+-")[:1].isalpha()
    return None if is_infinite or 0 < abs(value) < sys.float_info.min else value


def _wrong(message: str, node: yaml.Node) -> ParameterTextError:
    return ParameterTextError(message, node.start_mark.line + 1)


def evaluate_sources(unit: Unit, losses: Losses) -> None:
    """Set `parameters` and `for_others` of a unit from its `sources`; report unreadable files."""
    sections: dict[str, dict[str, Parameter]] = {}
    for source in unit.sources:
        if isinstance(source, Values):
            found = [Section(source.pattern, source.parameters)]
        else:
            found = _sections_of(source, unit, losses)
        for section in found:
            values = sections.setdefault(section.pattern, {})
            values.update((each.name, each) for each in section.parameters)
    take_sections(
        unit, [Section(pattern, tuple(each.values())) for pattern, each in sections.items()]
    )


def take_sections(unit: Unit, sections: Iterable[Section]) -> None:
    """Give a node, and others in its process, what they get of sections in rcl's order.

    As rclcpp does it: of all sections that are for the node, in their order, the last value.
    """
    own: dict[str, Parameter] = {}
    for_others: list[Section] = []
    name = unit.full_name
    for section in sections:
        if section.pattern == FOR_ALL or (name and matches(section.pattern, name)):
            own.update({each.name: each for each in section.parameters})
        if section.pattern != name and section.parameters:
            for_others.append(section)
    unit.parameters = list(own.values())
    if isinstance(unit, LaunchedProcess):
        unit.for_others = for_others


def _sections_of(source: ParameterFile, unit: Unit, losses: Losses) -> list[Section]:
    name = source.path or "its parameter file"
    try:
        return read_sections(text_of(source.path) if source.text is None else source.text)
    except ParameterTextError as error:
        place = f"{name}:{error.line}" if source.path else f"{name}, line {error.line}"
        losses.lost(unit.described, f"{place}: {error}")
    except UnreadableError as error:
        losses.lost(unit.described, f"{name}: {error}")
    return []
