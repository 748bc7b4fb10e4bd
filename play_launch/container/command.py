"""Command line and environment of containers and of ordinary processes.

Nothing is started here.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping  # noqa: TC003 - msgspec evaluates the annotations
from contextlib import suppress
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Final, TypeAlias

from msgspec import Struct
from msgspec.structs import replace

from play_launch.config.model import ContainerType, Isolation, MemoryDomains, OnExit
from play_launch.config.resources import NO_LIMITS, NO_RESOURCES, Resources
from play_launch.config.substitutions import ament_prefixes, not_installed, package_prefix
from play_launch.config.text import listed, similar
from play_launch.container.environment import (
    Allocator,
    child_environment,
    find_allocator,
    for_isolation,
    foreign_python_environment,
    with_safe_waits,
)
from play_launch.container.ros import RosInstallation  # noqa: TC001 - as above

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Sequence

    from play_launch.config.model import (
        ComposableNodeConfig,
        ContainerConfig,
        ProcessConfig,
        ReplayConfig,
    )


class NotInPackageError(Exception):
    """No prefix of AMENT_PREFIX_PATH has a package, or the executable or component in it."""


_CONTAINER_SHARE: Final = 0.6
"""Part of the time for asking that the container gives its nodes; the rest is its own."""
_MOST_NODES: Final = 64
"""Nodes of several containers in one process: the work of a stop grows with their square."""


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


SharedKey: TypeAlias = tuple[Command, str, int]
"""What containers of one process have in common: its command, `output`, and a number."""


def is_own(container: ContainerConfig) -> bool:
    """Whether it runs our own program."""
    return not container.attach and container.container_type is not ContainerType.STOCK


def shares_memory(container: ContainerConfig) -> bool:
    """Whether its nodes are processes in its own memory."""
    return container.container_type.is_isolated and container.isolation is not Isolation.PROCESS


def stays_alone(container: ContainerConfig) -> str:
    """Give the reason why `consolidate` leaves a container alone; empty: it does not."""
    if not is_own(container) or not shares_memory(container):
        return "its nodes do not share memory"
    if container.on_exit is OnExit.SHUTDOWN:
        return "it ends the system when it exits (on_exit: shutdown)"
    if container.memory_domains is not MemoryDomains.OFF:
        return "a process has protection keys for few nodes (memory_domains)"
    if container.resources.group != NO_LIMITS:
        return "its control group has limits"
    for key in ("prefix", "process_parameters", "ros_arguments", "arguments"):
        if getattr(container, key):
            return f"its {key} are for a process"
    return ""


def allocator_for(config: ReplayConfig) -> Allocator:
    """Find what the isolated containers of a system preload; searches only if there are any."""
    needed = any(shares_memory(container) for container in config.containers)
    return find_allocator() if needed else Allocator(None)


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
        binary: The program `component_container`, or that of a stock container.
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
    is_stock = config.container_type is ContainerType.STOCK
    if config.resources.lock_memory and not is_stock:
        argv.append("--lock_memory")
    if config.container_type.is_multi_threaded:
        argv.append("--use_multi_threaded_executor")
    if config.thread_num is not None:
        argv += ["--thread_num", str(config.thread_num)]
    if stop_timeout is not None:
        argv += ["--stop_timeout", f"{stop_timeout:g}"]
    argv += config.arguments
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
        parameter_file: A file with its parameters.

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
        NotInPackageError: When no prefix has it.
    """
    folders = [prefix / "lib" / package for prefix in prefixes]
    for folder in folders:
        if _is_executable(folder / executable):
            return folder / executable
    known = {path.name for each in folders for path in each.glob("*") if _is_executable(path)}
    raise _not_in(package, prefixes, "executable", executable, known)


def _is_executable(path: Path) -> bool:
    return path.is_file() and os.access(path, os.X_OK)


def _not_in(
    package: str, prefixes: Iterable[Path], kind: str, name: str, known: Collection[str]
) -> NotInPackageError:
    prefix = package_prefix(package, prefixes)
    if not known and prefix is None:
        return NotInPackageError(not_installed(package))
    home = f"package {package} in {prefix}" if prefix else f"package {package}"
    if not known:
        return NotInPackageError(f"{home} has no {kind}s")
    close = similar(name, known)
    hint = f"did you mean {close}?" if close else f"it has {listed(sorted(known), 10)}"
    return NotInPackageError(f"{home} has no {kind} {name}; {hint}")


_INDEXES: Final = ("play_launch_components", "rclcpp_components")
"""Types of the ament resources that list components, a line each: `class;library`."""


def component_library(package: str, plugin: str, prefixes: Sequence[Path]) -> Path:
    """Find the library of a component as the container does: in the first index of the package.

    Raises:
        NotInPackageError: When that does not name it.
    """
    known: dict[str, Path] = {}
    for index, prefix in product(_INDEXES, prefixes):
        path = Path(f"{prefix}/share/ament_index/resource_index/{index}/{package}")
        with suppress(OSError, ValueError):
            lines = (each.strip().partition(";") for each in path.read_text("utf-8").splitlines())
            known = {name: prefix / library for name, _, library in lines if library}
            break
    if plugin in known:
        return known[plugin]
    raise _not_in(package, prefixes, "component", plugin, known)


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


def container_command(
    config: ContainerConfig, machine: Machine, parameter_file: Path | None, *, ask: float
) -> Command:
    """Make the command of a container that we start; ``ask`` is as in `StopLimits`.

    Parameters for nodes that are made in it are in the file, if there are any.

    Raises:
        NotInPackageError: When a stock container's program is not there.
    """
    environment = container_environment(config, machine)
    if config.container_type is ContainerType.STOCK:
        program = find_executable(config.package, config.executable, ament_prefixes(environment))
        argv = container_argv(config, program, parameter_file=parameter_file)
    else:
        argv = container_argv(
            config,
            machine.container,
            stop_timeout=ask * _CONTAINER_SHARE,
            parameter_file=parameter_file,
        )
    return Command(argv, environment, config.cwd, resources=config.resources)


def shared_processes(config: ReplayConfig, machine: Machine) -> dict[str, SharedKey]:
    """Give each container that shares a process, by its name, what identifies the process.

    Containers are put together in their order, as long as a process has few enough nodes.
    """
    found: dict[str, SharedKey] = {}
    kinds: list[tuple[Command, str]] = []
    nodes: list[int] = []
    for container in config.containers:
        if not container.consolidate or stays_alone(container):
            continue
        unnamed = replace(container, name="", namespace="")
        command = container_command(unnamed, machine, None, ask=config.stop.ask)
        like = command, str(container.output)
        size = len(container.composable_nodes)
        number = max((i for i, kind in enumerate(kinds) if kind == like), default=-1)
        if number < 0 or nodes[number] + size > _MOST_NODES:
            number = len(kinds)
            kinds.append(like)
            nodes.append(0)
        nodes[number] += size
        found[container.full_name] = (*like, number)
    return found


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
    argv = os.fspath(machine.container), "--probe", node.package, node.plugin
    return Command(argv, container_environment(container, machine))


def process_command(
    config: ProcessConfig, machine: Machine, parameter_file: Path | None
) -> Command:
    """Make the command of an ordinary node; its parameters are in the file, if it has any.

    Raises:
        NotInPackageError: When its package has no such executable.
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
