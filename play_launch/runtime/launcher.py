"""Starts the processes of a system, with what they need of the machine."""

from __future__ import annotations

import asyncio
import errno
import logging
import os
import socket
import time
from contextlib import ExitStack, suppress
from functools import partial
from typing import TYPE_CHECKING, Final

from msgspec.structs import asdict, replace

from play_launch.config.model import ContainerConfig, ContainerType
from play_launch.config.substitutions import ament_prefixes
from play_launch.container.cdr.structure import definitions
from play_launch.container.channel import CONTROL_FD_VARIABLE, ControlChannel
from play_launch.container.command import (
    Machine,
    NotInPackageError,
    allocator_for,
    component_library,
    container_command,
    container_environment,
    probe_command,
    process_command,
    shared_processes,
    shares_memory,
)
from play_launch.container.messages import Hello
from play_launch.container.parameter_files import ParameterFileError, ParameterFiles
from play_launch.container.ros import (
    NotInstalledError,
    component_container,
    ros_installation,
    spawn_guard,
)
from play_launch.process.cgroups.group import Group, GroupError
from play_launch.process.cgroups.session_groups import SessionGroups
from play_launch.process.cgroups.usage import usage_of
from play_launch.process.child import INHERITED, spawn
from play_launch.process.descendants import Shared, in_a_thread
from play_launch.process.guard import SessionGuard, SpawnError
from play_launch.process.identity import read_stat
from play_launch.process.kin import mark_for
from play_launch.process.preflight import (
    full_shared_memory,
    shared_memory_problem,
)
from play_launch.process.stop import StopPolicy
from play_launch.recording.environment import OURSELVES, package_version
from play_launch.ros.fastdds.middleware import asks_for_fastdds
from play_launch.ros.fastdds.shared_memory import sweep_command, sweep_shared_memory
from play_launch.runtime.shared_process import (
    CONTAINERS_FD_VARIABLE,
    SharedMember,
    SharedProcess,
)
from play_launch.supervisor.events import SubjectKind

if TYPE_CHECKING:
    from collections.abc import Callable

    from play_launch.config.model import (
        ComposableNodeConfig,
        ProcessConfig,
        ReplayConfig,
    )
    from play_launch.container.command import Command, SharedKey
    from play_launch.process.child import Child
    from play_launch.process.lines import OutputCallback
    from play_launch.runtime.stock_containers import AttachedContainer, StockContainers
    from play_launch.runtime.stock_link import StockLink
    from play_launch.supervisor.events import GroupSample

    ManagedProcess = Child | AttachedContainer | SharedMember
    ControlLink = ControlChannel | StockLink

_log = logging.getLogger(__name__)

_LASTING: Final = frozenset(
    {0, errno.ENOENT, errno.ENOTDIR, errno.EISDIR, errno.ELOOP, errno.ENAMETOOLONG, errno.EACCES}
    | {errno.EPERM, errno.ENOEXEC, errno.ELIBBAD, errno.E2BIG, errno.EINVAL, errno.ENOSYS}
)
"""Errors of a start, 0 for unusable arguments, that the next one would meet as well."""


class StartError(Exception):
    """A process could not be started.

    Attributes:
        permanent: Whether the next try would fail in the same way.
    """

    def __init__(self, reason: str, *, permanent: bool) -> None:
        super().__init__(reason)
        self.permanent = permanent


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
            *(each.resources.group for each in config.members),
            *(node.resources.group for each in config.containers for node in each.composable_nodes),
        ]
        is_enabled = config.cgroups.enabled
        if any(limits) if is_enabled is None else is_enabled:
            controllers = (each.controllers() for each in limits)
            self.begin(config.cgroups, frozenset().union(*controllers))

    def of(self, config: ContainerConfig | ProcessConfig) -> tuple[Group | None, tuple[str, ...]]:
        """Make that of a process; gives it and what the process asks for. Raises StartError."""
        if self.folder is None:
            return None, ()
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
        if self.folder is None:
            return ()
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


class NativeLauncher:
    """Starts containers of our own and ordinary executables of this machine."""

    def __init__(
        self, config: ReplayConfig, publish: Callable[[GroupSample], None] = lambda _: None
    ) -> None:
        """Find everything that the system needs; reads folders, writes files.

        ``publish`` takes the last numbers of control groups, in the loop's thread.

        Raises:
            NotInstalledError: When ROS or a program of ours is not there.
            MixedInstallationError: When ROS is there twice.
            GroupError: When there are no control groups, which are required.
        """
        definitions()  # so that no file is read in the event loop
        self._machine = Machine(ros_installation(), component_container(), os.environ)
        self._guard_program = spawn_guard()
        self._guards: list[SessionGuard] = []
        self._parameters = ParameterFiles()
        self._stock: StockContainers | None = None
        self._shares: dict[str, SharedKey] = {}
        """Containers that share a process."""
        self._shared: list[SharedProcess] = []
        self._processes = 0
        """Number of shared processes so far."""
        self._uses_fastdds = False
        self._sweeps = Shared(self._sweep)
        self.policy = StopPolicy()
        self.groups = MemberGroups(publish)
        self.hello = Hello(
            version=package_version(OURSELVES) or "unknown",
            pid=os.getpid(),
            start_time=read_stat(os.getpid()).start_time,
        )
        """What the supervisor says to each container first."""
        self._prepare(config)
        if self._uses_fastdds and (short := shared_memory_problem(_participants(config))):
            _log.warning("%s", short)

    async def prepare(self, config: ReplayConfig) -> None:
        """Get ready for what a changed system needs; raises StartError."""
        try:
            await asyncio.to_thread(self._prepare, config)
        except (GroupError, NotInstalledError) as error:
            raise StartError(str(error), permanent=True) from error

    def _prepare(self, config: ReplayConfig) -> None:
        self._parameters.write(config.members)
        if self._machine.allocator is None:
            found = allocator_for(config)
            if found.problem:  # once for the whole system
                _log.warning("%s", found.problem)
            self._machine = replace(self._machine, allocator=found.library)
        self._prepare_stock(config)
        self.groups.prepare(config)
        self.policy = StopPolicy(**asdict(config.stop))
        self._shares = shared_processes(config, self._machine)
        self._uses_fastdds |= any(
            asks_for_fastdds({**os.environ, **each.environment}) for each in config.members
        )

    def _prepare_stock(self, config: ReplayConfig) -> None:
        if all(each.container_type is not ContainerType.STOCK for each in config.containers):
            return
        if self._stock is None:
            if problem := full_shared_memory():
                # It may have filled up since the start. Loading rcl is what maps it, and SIGBUS
                # would end the supervisor without a word: no handler reaches the thread that gets
                # it.
                raise NotInstalledError(f"nothing was started: {problem}")
            # A quarter of all modules of ours, for one type of container.
            from play_launch.runtime.stock_containers import StockContainers  # noqa: PLC0415

            self._stock = StockContainers()
        self._stock.extend(config)

    async def start_container(
        self, config: ContainerConfig, on_output: OutputCallback
    ) -> tuple[ManagedProcess, ControlLink]:
        """Start a container, or attach to it, with a way to talk to it; raises StartError."""
        if config.attach:
            assert self._stock is not None
            return self._stock.attach(config)
        command = await _made(
            lambda: container_command(
                config, self._machine, self._parameters.of(config), ask=self.policy.ask
            )
        )
        if config.container_type is ContainerType.STOCK:
            assert self._stock is not None
            process = await self._spawn(command, on_output, config)
            try:
                return process, self._stock.talk_to(config, process)
            except Exception:
                process.kill()
                raise
        try:
            ours, theirs = socket.socketpair()
        except OSError as error:
            raise StartError(f"no control channel: {error.strerror}", permanent=False) from error
        with ExitStack() as opened:
            opened.callback(ours.close)
            with theirs:  # as long as we hold it as well, the end of the stream never comes
                if config.full_name in self._shares:
                    channel = ControlChannel(ours, container=config.full_name)
                    opened.callback(channel.close)
                    member = await self._share(config, command, on_output, channel, theirs.fileno())
                    opened.pop_all()
                    return member, channel
                environment = {**command.environment, CONTROL_FD_VARIABLE: str(INHERITED)}
                command = replace(command, environment=environment)
                process = await self._spawn(command, on_output, config, control_fd=theirs.fileno())
            opened.pop_all()
        return process, ControlChannel(ours, container=config.full_name)

    async def _share(
        self,
        config: ContainerConfig,
        command: Command,
        on_output: OutputCallback,
        channel: ControlChannel,
        control_fd: int,
    ) -> SharedMember:
        """Start a container in a process with others like it; raises StartError."""
        key = self._shares[config.full_name]
        shared = key[0]
        self._shared = [each for each in self._shared if each.takes_more]
        process = next((each for each in self._shared if each.key == key), None)
        if process is None:
            process = SharedProcess(key)
            self._shared.append(process)

        async def spawn(on_output: OutputCallback, inherited: int) -> Child:
            self._processes += 1
            own = replace(config, full_name=f"/[process {self._processes}]", composable_nodes=())
            environment = {**shared.environment, CONTAINERS_FD_VARIABLE: str(INHERITED)}
            made = replace(shared, environment=environment)
            return await self._spawn(made, on_output, own, control_fd=inherited)

        group, _ = self.groups.of(config)
        member = SharedMember(
            config.full_name, command.argv, channel, on_output, group=group, policy=self.policy
        )
        try:
            await process.add(member, control_fd, spawn)
        except OSError as error:
            reason = f"no container in a process with others: {error.strerror}"
            raise StartError(reason, permanent=False) from error
        return member

    async def library_of(self, container: ContainerConfig, node: ComposableNodeConfig) -> str:
        """Find the library in the ament index that the container uses; empty: it has none."""
        prefixes = ament_prefixes(container_environment(container, self._machine))
        with suppress(NotInPackageError):
            find = partial(component_library, node.package, node.plugin, prefixes)
            return str(await in_a_thread(find))
        return ""

    async def start_probe(
        self, container: ContainerConfig, node: ComposableNodeConfig, on_output: OutputCallback
    ) -> Child:
        """Start a scratch process like the container itself; raises StartError."""
        return await self._spawn(probe_command(container, node, self._machine), on_output)

    async def start_process(self, config: ProcessConfig, on_output: OutputCallback) -> Child:
        """Start an ordinary executable; raises StartError."""
        command = await _made(
            lambda: process_command(config, self._machine, self._parameters.of(config))
        )
        return await self._spawn(command, on_output, config)

    async def clean_up(self) -> None:
        """Remove the shared memory that killed processes left behind, where Fast DDS is in use."""
        if self._uses_fastdds:
            await self._sweeps.result()

    async def _sweep(self) -> None:
        try:
            report = await sweep_shared_memory()
        except OSError as error:
            _log.warning("shared memory was not cleaned up: %s", error)
            return
        if report.removed:
            _log.info("removed %d files that dead processes left", len(report.removed))
        for name, reason in report.failed.items():
            _log.warning("%s is left in shared memory: %s", name, reason)

    async def close(self) -> None:
        """Remove our own files."""
        await asyncio.to_thread(self._parameters.remove)
        for guard in self._guards:
            await guard.end()
        await asyncio.to_thread(self.groups.end)
        if self._stock is not None:
            await asyncio.to_thread(self._stock.close)
            # As long as we took part ourselves, we held what dead containers had left.
            await self.clean_up()

    async def _spawn(
        self,
        command: Command,
        on_output: OutputCallback,
        config: ContainerConfig | ProcessConfig | None = None,
        *,
        control_fd: int | None = None,
    ) -> Child:
        group, entry = (None, ()) if config is None else self.groups.of(config)
        try:
            # One that is lost is kept: what it has started would end with it.
            if not (self._guards and self._guards[-1].is_alive):
                guard = SessionGuard.start(self._guard_program, afterwards=sweep_command())
                self._guards.append(guard)
            self.groups.entrust(self._guards[-1])
            return await spawn(
                command.argv,
                env=command.environment,
                cwd=command.cwd,
                emulate_tty=command.emulate_tty,
                guard=self._guards[-1],
                descriptors={} if control_fd is None else {INHERITED: control_fd},
                on_output=on_output,
                # Our containers end in order when their control channel does.
                leaves_by_itself=control_fd is not None,
                settings=(*entry, *command.resources.settings()),
                group=group,
                mark="" if config is None else mark_for(os.getpid(), config.full_name),
            )
        except SpawnError as error:
            raise StartError(str(error), permanent=error.errno in _LASTING) from error
        except OSError as error:
            raise StartError(f"no guard: {error.strerror}", permanent=False) from error


async def _made(make: Callable[[], Command]) -> Command:
    """Make a command, for which programs are looked up; raises StartError."""
    try:
        return await in_a_thread(make)
    except (NotInPackageError, ParameterFileError, ValueError) as error:
        raise StartError(str(error), permanent=True) from error
    except OSError as error:
        raise StartError(str(error.strerror), permanent=error.errno in _LASTING) from error


def _participants(config: ReplayConfig) -> int:
    """Count the participants of DDS, if each process is one.

    A node with memory of its own is one of its own; the others share their container's.
    """
    isolated = [each for each in config.containers if each.container_type.is_isolated]
    apart = sum(len(each.composable_nodes) for each in isolated if not shares_memory(each))
    return len(config.containers) + len(config.nodes) + apart
