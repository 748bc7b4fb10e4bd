"""Command lines and parameter files of containers and of ordinary processes."""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import yaml

from play_launch.config.model import FOR_ALL, MemoryDomains, ParameterType, ProcessConfig

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from play_launch.config.model import ContainerConfig, ParameterConfig


class ExecutableNotFoundError(Exception):
    """A package has no such executable in any prefix of AMENT_PREFIX_PATH."""

    def __init__(self, package: str, executable: str, prefixes: Sequence[Path]) -> None:
        searched = ", ".join(map(str, prefixes)) or "nothing, AMENT_PREFIX_PATH is empty"
        super().__init__(
            f"package {package} has no executable {executable}: there is no "
            f"lib/{package}/{executable} in the prefixes searched ({searched})"
        )
        self.package = package
        self.executable = executable


def container_argv(
    config: ContainerConfig,
    binary: Path,
    *,
    stop_timeout: float | None = None,
    parameter_file: Path | None = None,
) -> tuple[str, ...]:
    """Make the command line of a container.

    Args:
        config: The container.
        binary: The program `component_container`.
        stop_timeout: Seconds that it gives its nodes when it stops; None for its own default.
        parameter_file: A file with parameters for nodes that are made in it.
    """
    argv = [*config.prefix, os.fspath(binary)]
    if config.container_type.is_isolated:
        argv += ["--isolated", "--isolation", str(config.isolation)]
        if config.memory_domains is not MemoryDomains.OFF:
            argv += ["--memory_domains", str(config.memory_domains)]
        if config.core_dumps:
            argv.append("--core_dumps")
    if config.resources.lock_memory:
        argv.append("--lock_memory")
    if config.container_type.is_multi_threaded:
        argv.append("--use_multi_threaded_executor")
    if config.thread_num is not None:
        argv += ["--thread_num", str(config.thread_num)]
    if stop_timeout is not None:
        argv += ["--stop_timeout", f"{stop_timeout:g}"]
    argv += config.arguments
    return (*argv, *_ros_arguments(config, parameter_file=parameter_file))


def probe_argv(package: str, plugin: str, binary: Path) -> tuple[str, ...]:
    """Make the command line of a scratch process that loads the library of one component.

    Args:
        package: The package that the component is in.
        plugin: The class.
        binary: The program `component_container`.
    """
    return (os.fspath(binary), "--probe", package, plugin)


def stock_container_argv(
    config: ContainerConfig, program: Path, parameter_file: Path | None = None
) -> tuple[str, ...]:
    """Make the command line of a container that is not our own."""
    argv = [*config.prefix, os.fspath(program), *config.arguments]
    return (*argv, *_ros_arguments(config, parameter_file=parameter_file))


def process_argv(
    config: ProcessConfig, *, executable: Path | None = None, parameter_file: Path | None = None
) -> tuple[str, ...]:
    """Make the command line of an ordinary node.

    As in ROS's own launch API, the name and namespace of a `command` are its label only, while
    those of a package's executable are remapped in the node. A `command` that is given nothing for
    ROS (remapping, parameter, log level, ROS argument) stays exactly as it is: it may be no ROS
    program at all.

    Args:
        config: The node.
        executable: What `find_executable` found; needed where `config.command` is None.
        parameter_file: A file with its parameters, see `write_parameter_file`.

    Raises:
        ValueError: When neither a command nor an executable is there.
    """
    if config.command is not None:
        argv = config.command
    elif executable is not None:
        argv = (os.fspath(executable),)
    else:
        raise ValueError(f"{config.full_name} has neither a command nor an executable")
    ros_arguments = _ros_arguments(
        config,
        is_named=config.command is None,
        remappings=config.remappings,
        parameter_file=parameter_file,
    )
    return (*config.prefix, *argv, *config.arguments, *ros_arguments)


def find_executable(package: str, executable: str, prefixes: Sequence[Path]) -> Path:
    """Find `<prefix>/lib/<package>/<executable>` as `ros2 run` does; the first prefix wins.

    Raises:
        ExecutableNotFoundError: When no prefix has it.
    """
    for prefix in prefixes:
        path = prefix / "lib" / package / executable
        if path.is_file() and os.access(path, os.X_OK):
            return path
    raise ExecutableNotFoundError(package, executable, prefixes)


def remap_rules(remappings: Iterable[tuple[str, str]]) -> tuple[str, ...]:
    """Write remappings as rules, `from:=to`."""
    return tuple(f"{source}:={target}" for source, target in remappings)


def _ros_arguments(
    config: ContainerConfig | ProcessConfig,
    *,
    is_named: bool = True,
    remappings: Iterable[tuple[str, str]] = (),
    parameter_file: Path | None = None,
) -> list[str]:
    rules = list(remap_rules(remappings))
    # A node without a declared name keeps its own: an empty remapping would be refused by rcl.
    if is_named and config.name:
        rules.append(f"__node:={config.name}")
    if is_named and config.namespace:
        rules.append(f"__ns:={config.namespace}")
    arguments = [part for rule in rules for part in ("-r", rule)]
    if parameter_file is not None:
        arguments += ["--params-file", os.fspath(parameter_file)]
    if config.log_level is not None:
        arguments += ["--log-level", config.log_level]
    arguments += config.ros_arguments
    return ["--ros-args", *arguments] if arguments else []


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
    """A parameter cannot be written into a parameter file of ROS."""

    def __init__(self, name: str, reason: str) -> None:
        super().__init__(f"parameter {name}: {reason}")
        self.name = name


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


def write_parameter_file(text: str, directory: Path) -> Path:
    """Write a parameter file with a name of its own into `directory`; its owner deletes it.

    Raises OSError when it cannot be written.
    """
    descriptor, name = tempfile.mkstemp(prefix="parameters-", suffix=".yaml", dir=directory)
    with os.fdopen(descriptor, "w", encoding="utf-8") as file:
        file.write(text)
    return Path(name)


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
    kind, value = parameter.value.type, parameter.value.value
    if kind not in _SCALARS:
        raise ParameterFileError(parameter.name, "a parameter file cannot hold a byte array")
    if not isinstance(value, tuple):
        if kind is ParameterType.DOUBLE and _is_subnormal(value):
            raise ParameterFileError(parameter.name, _SUBNORMAL)
        return _scalar(kind, value)
    if not value:
        raise ParameterFileError(
            parameter.name, "a parameter file cannot hold an empty array, it would have no type"
        )
    items = [_scalar(_SCALARS[kind], item) for item in value]
    if kind is ParameterType.DOUBLE_ARRAY and any(map(_is_subnormal, value)):
        raise ParameterFileError(parameter.name, _SUBNORMAL)
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
