"""Parameters of a node from their sources, which are one ordered list: the later one wins."""

from __future__ import annotations

from typing import TYPE_CHECKING

from play_launch.config.model import ParameterConfig, ParameterValue
from play_launch.config.parameter_values import parameter_value
from play_launch.config.problems import Place, join_path
from play_launch.config.yaml_scalars import ScalarKind
from play_launch.config.yaml_tree import Mapping, Node, Scalar, Sequence, describe_node

if TYPE_CHECKING:
    from play_launch.config.parameter_files import ParameterFiles
    from play_launch.config.report import Report

_KEY_OF_PARAMETER_FILES = "ros__parameters"


def resolve_parameters(
    node: Node | None,
    path: str,
    report: Report,
    *,
    full_name: str | None,
    files: ParameterFiles | None,
) -> tuple[ParameterConfig, ...]:
    """Return the parameters from the sources at `node`.

    A source is a mapping or the path of a parameter file; `full_name` (None where the
    configuration does not give it) selects the sections of such a file. `files` is None where
    files are not allowed.
    """
    if node is None:
        return ()
    values: dict[str, ParameterValue] = {}
    if isinstance(node, Mapping):
        values.update(flatten(node, path, report))
    elif isinstance(node, Sequence) and node.array_tag is None:
        for index, source in enumerate(node.items):
            where = f"{path}[{index}]"
            if isinstance(source, Mapping):
                values.update(flatten(source, where, report))
            elif _is_path(source) and files is not None:
                values.update(files.select(source, where, full_name))
            elif not _is_invalid(source):
                report.add(
                    source.place, where, f"expected {_source(files)}, given {_given(source)}"
                )
    elif not _is_invalid(node):
        message = f"expected a mapping or a list of sources, given {_given(node)}"
        if _is_path(node) and files is not None:
            message += "; put the file into a list: [ ... ]"
        report.add(node.place, path, message)
    return tuple(ParameterConfig(name, value) for name, value in values.items())


def flatten(mapping: Mapping, path: str, report: Report) -> dict[str, ParameterValue]:
    """Return the parameters in `mapping`, the names of nested ones joined with dots."""
    values: dict[str, ParameterValue] = {}
    places: dict[str, Place] = {}
    _flatten_into(mapping, "", path, (values, places), report)
    return values


def _flatten_into(
    mapping: Mapping,
    prefix: str,
    path: str,
    into: tuple[dict[str, ParameterValue], dict[str, Place]],
    report: Report,
) -> None:
    values, places = into
    for entry in mapping.entries:
        name = prefix + entry.key
        where = join_path(path, entry.key)
        if "\x00" in entry.key:
            report.add(entry.place, where, "a parameter name cannot hold a NUL character")
        elif entry.key == _KEY_OF_PARAMETER_FILES:
            message = f"{_KEY_OF_PARAMETER_FILES} belongs into parameter files, above the names"
            report.add(entry.place, where, f"{message}; write the names here directly")
        elif isinstance(entry.value, Mapping):
            _flatten_into(entry.value, name + ".", where, into, report)
        elif name in places:
            message = f"the parameter {name} is given twice, first at {places[name]}"
            report.add(entry.place, where, message)
        else:
            places[name] = entry.place
            value = parameter_value(entry.value, where, report)
            if value is not None:
                values[name] = value


def _source(files: ParameterFiles | None) -> str:
    return "a mapping" if files is None else "a mapping or the path of a parameter file"


def _given(node: Node) -> str:
    return describe_node(node)


def _is_path(node: Node) -> bool:
    return isinstance(node, Scalar) and node.kind is ScalarKind.STRING


def _is_invalid(node: Node) -> bool:
    return isinstance(node, Scalar) and node.kind is ScalarKind.INVALID
