"""All processes of a system: the command line of each, or why it has none."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

from msgspec import Struct

from play_launch.config.model import ContainerConfig, ContainerType, ProcessConfig
from play_launch.container.allocator import Allocator, find_allocator
from play_launch.container.channel import CONTROL_FD_VARIABLE
from play_launch.container.command import ExecutableNotFoundError
from play_launch.container.parameter_file import ParameterFileError, parameter_file_of
from play_launch.process.kin import MEMBER_VARIABLE, mark_for
from play_launch.runtime.commands import Command, container_command, process_command
from play_launch.runtime.needs import shares_memory

if TYPE_CHECKING:
    from collections.abc import Iterator

    from play_launch.config.model import ReplayConfig
    from play_launch.runtime.commands import Machine

PARAMETER_FILE: Final = Path("(parameter file)")
"""Stands in a command line for the file, which is written for each run."""
DESCRIPTOR: Final = "(descriptor)"
"""Stands for the number of a descriptor that the process inherits."""
SUPERVISOR: Final = "(pid)"
"""Stands for the pid of the supervisor."""


class Start(Struct, frozen=True):
    """A process to be started: its command, or the reason why there is none."""

    config: ContainerConfig | ProcessConfig
    command: Command | str
    parameter_file: str | None = None
    """What is in the file."""


def survey(config: ReplayConfig, machine: Machine) -> Iterator[Start]:
    """Give the containers and processes as declared, without attached ones."""
    for container in config.containers:
        if not container.attach:
            yield _container(container, machine, config.stop.ask)
    for process in config.nodes:
        yield _process(process, machine)


def allocator_for(config: ReplayConfig) -> Allocator:
    """Find what the isolated containers of a system preload; searches only if there are any."""
    needed = any(shares_memory(container) for container in config.containers)
    return find_allocator() if needed else Allocator(None)


def _container(config: ContainerConfig, machine: Machine, ask: float) -> Start:
    try:
        text = parameter_file_of(config)
        command = container_command(config, machine, _file(text), ask=ask)
    except (ParameterFileError, ExecutableNotFoundError) as error:
        return Start(config, str(error))
    if config.container_type is not ContainerType.STOCK:
        command = command.with_variables({CONTROL_FD_VARIABLE: DESCRIPTOR})
    return Start(config, _marked(command, config), text)


def _process(config: ProcessConfig, machine: Machine) -> Start:
    try:
        text = parameter_file_of(config)
        command = process_command(config, machine, _file(text))
        return Start(config, _marked(command, config), text)
    except (ParameterFileError, ExecutableNotFoundError, ValueError) as error:
        return Start(config, str(error))


def _marked(command: Command, config: ContainerConfig | ProcessConfig) -> Command:
    return command.with_variables({MEMBER_VARIABLE: mark_for(SUPERVISOR, config.full_name)})


def _file(text: str | None) -> Path | None:
    return None if text is None else PARAMETER_FILE
