"""Parameters of containers and ordinary processes, in files as rcl reads them."""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import yaml

from play_launch.config.model import FOR_ALL, ParameterType, ProcessConfig

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from play_launch.config.model import ContainerConfig, ParameterConfig, ParameterSection

    Key = tuple[str, tuple[ParameterConfig, ...], tuple[ParameterSection, ...]]


_SCALARS = {
    ParameterType.BOOL: ParameterType.BOOL,
    ParameterType.INTEGER: ParameterType.INTEGER,
    ParameterType.DOUBLE: ParameterType.DOUBLE,
    ParameterType.STRING: ParameterType.STRING,
    ParameterType.BOOL_ARRAY: ParameterType.BOOL,
    ParameterType.INTEGER_ARRAY: ParameterType.INTEGER,
    ParameterType.DOUBLE_ARRAY: ParameterType.DOUBLE,
    ParameterType.STRING_ARRAY: ParameterType.STRING,
}


class ParameterFileError(Exception):
    """Parameters cannot be written into a parameter file of ROS, or not into a file at all."""


def parameter_file_of(config: ContainerConfig | ProcessConfig) -> str | None:
    """Make the parameter file of a process; None where it needs none.

    Where other nodes of the process have parameters, those of the node are for its full name alone,
    as ROS's launch does it, if its name is given on the command line. Else they are for all.

    Raises:
        ParameterFileError: As `parameter_file_text`.
    """
    sections = [(each.pattern, each.parameters) for each in config.process_parameters]
    if isinstance(config, ProcessConfig) and config.parameters:
        is_named = bool(sections and config.name) and config.command is None
        sections.append((config.full_name if is_named else FOR_ALL, config.parameters))
    return parameter_file_text(sections) if sections else None


def parameter_file_text(sections: Iterable[tuple[str, Iterable[ParameterConfig]]]) -> str:
    """Make a parameter file of sections: the full name of a node or a pattern, and parameters.

    rcl's parser guesses types from the spelling, so each value is spelled as the type it has:
    doubles with a point or an exponent, strings in quotes. Of two values for one name the later
    one holds.

    Raises:
        ParameterFileError: For what such a file cannot express: byte arrays, empty arrays, and
            doubles next to 0 that rcl would read as strings.
    """
    values: dict[str, dict[str, yaml.Node]] = {}
    for pattern, parameters in sections:
        section = values.setdefault(pattern, {})
        section.update((each.name, _node(each)) for each in parameters)
    tree = _mapping(
        {
            pattern: _mapping({"ros__parameters": _mapping(section)})
            for pattern, section in values.items()
        }
    )
    return str(yaml.serialize(tree, width=float("inf"), allow_unicode=True))


_MAP = "tag:yaml.org,2002:map"
_SEQUENCE = "tag:yaml.org,2002:seq"
_TAGS = {
    ParameterType.BOOL: "tag:yaml.org,2002:bool",
    ParameterType.INTEGER: "tag:yaml.org,2002:int",
    ParameterType.DOUBLE: "tag:yaml.org,2002:float",
    ParameterType.STRING: "tag:yaml.org,2002:str",
}


def _mapping(values: Mapping[str, yaml.Node]) -> yaml.MappingNode:
    pairs = [(_scalar(ParameterType.STRING, key), value) for key, value in values.items()]
    return yaml.MappingNode(_MAP, pairs)


def _node(parameter: ParameterConfig) -> yaml.Node:
    kind, value, what = parameter.value.type, parameter.value.value, f"parameter {parameter.name}"
    if kind not in _SCALARS:
        raise ParameterFileError(f"{what}: a parameter file cannot hold a byte array")
    if not isinstance(value, tuple):
        if kind is ParameterType.DOUBLE and _is_subnormal(value):
            raise ParameterFileError(f"{what}: {_SUBNORMAL}")
        return _scalar(kind, value)
    if not value:
        raise ParameterFileError(
            f"{what}: a parameter file cannot hold an empty array, it would have no type"
        )
    items = [_scalar(_SCALARS[kind], item) for item in value]
    if kind is ParameterType.DOUBLE_ARRAY and any(map(_is_subnormal, value)):
        raise ParameterFileError(f"{what}: {_SUBNORMAL}")
    return yaml.SequenceNode(_SEQUENCE, items, flow_style=True)


_SUBNORMAL = f"ROS reads a number nearer to 0 than {sys.float_info.min} as a string"


def _is_subnormal(value: object) -> bool:
    # strtod(3) reports a range error for them, by which rcl takes them for no number.
    return isinstance(value, float) and 0 < abs(value) < sys.float_info.min


def _scalar(kind: ParameterType, value: object) -> yaml.ScalarNode:
    if kind is ParameterType.STRING:
        return yaml.ScalarNode(_TAGS[kind], str(value), style='"')
    if kind is ParameterType.BOOL:
        return yaml.ScalarNode(_TAGS[kind], "true" if value else "false")
    if kind is ParameterType.INTEGER:
        return yaml.ScalarNode(_TAGS[kind], str(value))
    return yaml.ScalarNode(_TAGS[kind], _double(float(str(value))))


def _double(value: float) -> str:
    """Spell a double so that both YAML 1.1 and rcl's parser read a double: 1.0, 1.0e+300, .inf."""
    text = repr(value)
    if text in {"inf", "-inf", "nan"}:
        return text.replace("inf", ".inf").replace("nan", ".nan")
    if "e" in text and "." not in text:
        return text.replace("e", ".0e")
    return text


class ParameterFiles:
    """The parameters of containers and ordinary processes, each in a file of its own."""

    def __init__(self) -> None:
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        self._paths: dict[Key, Path | ParameterFileError] = {}

    def write(self, configs: Iterable[ContainerConfig | ProcessConfig]) -> None:
        """Write the files that do not exist; old ones stay for restarts of running processes.

        What cannot be written is reported when the file is asked for.
        """
        for config in configs:
            if any(_key(config)[1:]) and _key(config) not in self._paths:
                try:
                    self._paths[_key(config)] = self._write(parameter_file_of(config) or "")
                except ParameterFileError as error:
                    self._paths[_key(config)] = error

    def of(self, config: ContainerConfig | ProcessConfig) -> Path | None:
        """Give the file; None when there are no parameters.

        Raises:
            ParameterFileError: When a file cannot express them, or could not be written.
        """
        path = self._paths.get(_key(config))
        if isinstance(path, ParameterFileError):
            raise path
        return path

    def remove(self) -> None:
        """Remove the files; may be called twice."""
        if self._folder is not None:
            self._folder.cleanup()

    def _write(self, text: str) -> Path:
        try:
            if self._folder is None:
                self._folder = tempfile.TemporaryDirectory(prefix="play-launch-")
            descriptor, name = tempfile.mkstemp(
                prefix="parameters-", suffix=".yaml", dir=self._folder.name
            )
            with os.fdopen(descriptor, "w", encoding="utf-8") as file:
                file.write(text)
        except OSError as error:
            reason = f"its parameters cannot be written to a temporary file: {error.strerror}"
            fix = "free some space, or set TMPDIR to another folder"
            raise ParameterFileError(f"{reason}; {fix}") from None
        return Path(name)


def _key(config: ContainerConfig | ProcessConfig) -> Key:
    own = config.parameters if isinstance(config, ProcessConfig) else ()
    return config.full_name, own, config.process_parameters
