"""Command line, environment, parameter file and control group of each process of a system.

Nothing is started here.
"""

from __future__ import annotations

import logging
import shutil
import tempfile
import time
from collections.abc import Mapping  # noqa: TC003 - msgspec evaluates the annotations
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final

from msgspec import Struct
from msgspec.structs import replace

from play_launch.config.model import ContainerConfig, ContainerType, Isolation, ProcessConfig
from play_launch.config.resources import NO_RESOURCES, Resources
from play_launch.config.substitutions import ament_prefixes
from play_launch.container.command import (
    ParameterFileError,
    container_argv,
    find_executable,
    parameter_file_of,
    probe_argv,
    process_argv,
    stock_container_argv,
    write_parameter_file,
)
from play_launch.container.environment import (
    Allocator,
    child_environment,
    find_allocator,
    for_isolation,
    foreign_python_environment,
    with_safe_waits,
)
from play_launch.container.ros import RosInstallation  # noqa: TC001 - as above
from play_launch.process.cgroups.group import Group, GroupError
from play_launch.process.cgroups.session import SessionGroups
from play_launch.process.cgroups.usage import usage_of
from play_launch.ros.fastdds.middleware import asks_for_fastdds
from play_launch.supervisor.events import SubjectKind

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from play_launch.config.model import (
        ComposableNodeConfig,
        ParameterConfig,
        ParameterSection,
        ReplayConfig,
    )
    from play_launch.process.guard import SessionGuard
    from play_launch.supervisor.events import GroupSample

    Config = ContainerConfig | ProcessConfig
    Key = tuple[str, tuple[ParameterConfig, ...], tuple[ParameterSection, ...]]


_log = logging.getLogger(__name__)


class StartError(Exception):
    """A process could not be started.

    Attributes:
        permanent: Whether the next try would fail in the same way.
    """

    def __init__(self, reason: str, *, permanent: bool) -> None:
        super().__init__(reason)
        self.permanent = permanent


def is_own(container: ContainerConfig) -> bool:
    """Whether it runs our own program."""
    return not container.attach and container.container_type is not ContainerType.STOCK


def shares_memory(container: ContainerConfig) -> bool:
    """Whether its nodes are processes in its own memory."""
    return container.container_type.is_isolated and container.isolation is not Isolation.PROCESS


def uses_fastdds(config: ReplayConfig, environment: Mapping[str, str]) -> bool:
    """Whether any process asks for Fast DDS; ``environment`` is what they inherit."""
    members: tuple[Config, ...] = (*config.containers, *config.nodes)
    return any(asks_for_fastdds({**environment, **each.environment}) for each in members)


def participants(config: ReplayConfig) -> int:
    """Count the participants of DDS, if each process is one.

    A node with memory of its own is one of its own; the others share their container's.
    """
    isolated = [each for each in config.containers if each.container_type.is_isolated]
    apart = sum(len(each.composable_nodes) for each in isolated if not shares_memory(each))
    return len(config.containers) + len(config.nodes) + apart


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


class ParameterFiles:
    """The parameters of containers and ordinary processes, each in a file of its own."""

    def __init__(self, configs: Iterable[Config]) -> None:
        """Write the files; what cannot be written is reported when the file is asked for."""
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        self._paths: dict[Key, Path | StartError] = {}
        self.write(configs)

    def write(self, configs: Iterable[Config]) -> None:
        """Write the files that do not exist; old ones stay for restarts of running processes."""
        for config in configs:
            if any(_key(config)[1:]) and _key(config) not in self._paths:
                self._paths[_key(config)] = self._write(config)

    def of(self, config: Config) -> Path | None:
        """Give the file; None when there are no parameters.

        Raises:
            StartError: When a file cannot express them, or could not be written.
        """
        path = self._paths.get(_key(config))
        if isinstance(path, StartError):
            raise path
        return path

    def remove(self) -> None:
        """Remove the files; may be called twice."""
        if self._folder is not None:
            self._folder.cleanup()

    def _write(self, config: Config) -> Path | StartError:
        try:
            text = parameter_file_of(config) or ""
            if self._folder is None:
                self._folder = tempfile.TemporaryDirectory(prefix="play-launch-")
            return write_parameter_file(text, Path(self._folder.name))
        except ParameterFileError as error:
            return StartError(str(error), permanent=True)
        except OSError as error:
            reason = f"its parameters cannot be written to a temporary file: {error.strerror}"
            fix = "free some space, or set TMPDIR to another folder"
            return StartError(f"{reason}; {fix}", permanent=True)


def _key(config: Config) -> Key:
    own = config.parameters if isinstance(config, ProcessConfig) else ()
    return config.full_name, own, config.process_parameters


class MemberGroups(SessionGroups):
    """Control groups of the session of this process; there are none yet."""

    def __init__(self, publish: Callable[[GroupSample], None]) -> None:
        """``publish`` takes the last numbers of each."""
        super().__init__()
        self._publish = publish
        self._entrusted: tuple[SessionGuard, int] | None = None

    def entrust(self, guard: SessionGuard) -> None:
        """Have the guard remove them if the supervisor dies; once for each guard and group."""
        folder = self.folder
        if folder is None:
            return
        entrusted = guard, Group(folder).number  # it may have been removed, and made anew
        if entrusted != self._entrusted:
            self._entrusted = entrusted
            with suppress(OSError):  # removed by another process
                guard.entrust(folder)

    def prepare(self, config: ReplayConfig) -> None:
        """Have groups, if the configuration asks for any; raises GroupError where it has to."""
        limits = [
            *(each.resources.group for each in config.containers),
            *(each.resources.group for each in config.nodes),
            *(node.resources.group for each in config.containers for node in each.composable_nodes),
        ]
        is_enabled = config.cgroups.enabled
        if any(limits) if is_enabled is None else is_enabled:
            controllers = (each.controllers() for each in limits)
            self.begin(config.cgroups, frozenset().union(*controllers))

    def of(self, config: Config) -> tuple[Group | None, tuple[str, ...]]:
        """Make that of a process; gives it and what the process asks for. Raises StartError."""
        kind, has_nodes = SubjectKind.PROCESS, False
        if isinstance(config, ContainerConfig):
            kind, has_nodes = SubjectKind.CONTAINER, config.container_type.is_isolated
        name, limits = config.full_name, config.resources.group
        used = partial(self._used, kind, name)
        try:
            made = self.member(name, limits, has_nodes=has_nodes, on_end=used)
        except GroupError as error:
            raise StartError(str(error), permanent=True) from error
        return (None, ()) if made is None else (made[0], (made[1],))

    def enter(self, config: ComposableNodeConfig, attempt: int) -> tuple[str, ...]:
        """Make that of a node; gives what its process asks for. Raises StartError."""
        key, limits = config.key, config.resources.group
        used = partial(self._used, SubjectKind.NODE, str(key))
        try:
            entry = self.node(key.container, key.name, attempt, limits, used)
        except GroupError as error:
            raise StartError(str(error), permanent=True) from error
        return () if entry is None else (entry,)

    def _used(self, kind: SubjectKind, key: str, group: Group) -> None:
        """Report what a group used all in all."""
        usage = usage_of(group)
        _log.info("the control group %s used %s", group.path.name, usage)
        self._publish(usage.sample(time.time_ns(), kind, key, group.number))


def allocator_for(config: ReplayConfig) -> Allocator:
    """Find what the isolated containers of a system preload; searches only if there are any."""
    needed = any(shares_memory(container) for container in config.containers)
    return find_allocator() if needed else Allocator(None)
