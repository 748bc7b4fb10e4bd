"""Command line and environment of each process, to start it or to show it.

Nothing is started here. Programs are looked up in the file system; all else follows from the
arguments.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping  # noqa: TC003 - msgspec evaluates the annotations
from pathlib import Path
from typing import TYPE_CHECKING, Final

from msgspec import Struct
from msgspec.structs import replace

from play_launch.config.ament_index import ament_prefixes
from play_launch.config.model import ContainerType
from play_launch.config.resources import NO_RESOURCES, Resources
from play_launch.container.allocator import for_isolation
from play_launch.container.command import (
    container_argv,
    find_executable,
    probe_argv,
    process_argv,
    stock_container_argv,
)
from play_launch.container.environment import child_environment, foreign_python_environment
from play_launch.container.preload import with_safe_waits
from play_launch.container.ros import RosInstallation  # noqa: TC001 - as above
from play_launch.runtime.needs import shares_memory

if TYPE_CHECKING:
    from play_launch.config.model import ComposableNodeConfig, ContainerConfig, ProcessConfig

_CONTAINER_SHARE: Final = 0.6
"""Part of the time for asking that the container gives its nodes; the rest is its own."""


class Machine(Struct, frozen=True):
    """What commands are made from besides the configuration."""

    ros: RosInstallation
    container: Path
    """The program `component_container`."""
    environment: Mapping[str, str]
    """What children inherit, usually our own."""
    allocator: Path | None = None
    """What isolated containers preload."""


class Command(Struct, frozen=True):
    """What is executed; without ``cwd`` in our own working directory."""

    argv: tuple[str, ...]
    environment: Mapping[str, str]
    cwd: Path | None = None
    emulate_tty: bool = False
    resources: Resources = NO_RESOURCES
    """What the process asks of the kernel before it is executed."""

    def with_variables(self, variables: Mapping[str, str]) -> Command:
        """Give it variables that are known only when it starts."""
        return replace(self, environment={**self.environment, **variables})


def container_command(
    config: ContainerConfig, machine: Machine, parameter_file: Path | None, *, ask: float
) -> Command:
    """Make the command of a container that we start; ``ask`` is as in `StopLimits`.

    Parameters for nodes that are made in it are in the file, if there are any.

    Raises:
        ExecutableNotFoundError: When a stock container's program is not there.
    """
    environment = container_environment(config, machine)
    if config.container_type is ContainerType.STOCK:
        program = find_executable(config.package, config.executable, ament_prefixes(environment))
        argv = stock_container_argv(config, program, parameter_file)
        return Command(argv, environment, config.cwd, resources=config.resources)
    stop_timeout = ask * _CONTAINER_SHARE
    argv = container_argv(
        config, machine.container, stop_timeout=stop_timeout, parameter_file=parameter_file
    )
    return Command(argv, environment, config.cwd, resources=config.resources)


def container_environment(config: ContainerConfig, machine: Machine) -> dict[str, str]:
    """Make the environment of a container, which the index of components is read in as well."""
    environment = child_environment(machine.environment, machine.ros, config.environment)
    if config.container_type is ContainerType.STOCK:
        return with_safe_waits(environment, machine.container)
    if shares_memory(config):
        environment = for_isolation(environment, machine.allocator)
    return environment


def probe_command(
    container: ContainerConfig, node: ComposableNodeConfig, machine: Machine
) -> Command:
    """Make the command of a scratch process like the container itself."""
    argv = probe_argv(node.package, node.plugin, machine.container)
    return Command(argv, container_environment(container, machine))


def process_command(
    config: ProcessConfig, machine: Machine, parameter_file: Path | None
) -> Command:
    """Make the command of an ordinary node; its parameters are in the file, if it has any.

    Raises:
        ExecutableNotFoundError: When its package has no such executable.
        ValueError: When it has neither a command nor an executable.
    """
    environment = child_environment(machine.environment, machine.ros, config.environment)
    executable = None
    if config.command is None and config.package is not None and config.executable is not None:
        prefixes = ament_prefixes(environment)
        executable = find_executable(config.package, config.executable, prefixes)
    argv = process_argv(config, executable=executable, parameter_file=parameter_file)
    program = shutil.which(argv[len(config.prefix)], path=environment.get("PATH"))
    if program is not None:
        environment = foreign_python_environment(environment, machine.ros, Path(program))
    environment = with_safe_waits(environment, machine.container)
    return Command(argv, environment, config.cwd, config.emulate_tty, config.resources)
