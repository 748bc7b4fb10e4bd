"""The command lines of containers and of ordinary nodes.

The functions that make them are pure; `find_executable` looks at the file system.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from play_launch.config.model import MemoryDomains

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

    from play_launch.config.model import ContainerConfig, ProcessConfig


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
