"""Starts the processes of a system, with what they need of the machine."""

from __future__ import annotations

import asyncio
import errno
import logging
import os
import signal
from contextlib import ExitStack
from typing import TYPE_CHECKING, Final, Protocol

from msgspec.structs import replace

from play_launch.config.model import ContainerType
from play_launch.config.substitutions import ament_prefixes
from play_launch.container.channel import CONTROL_FD_VARIABLE, ControlChannel, control_pair
from play_launch.container.command import ExecutableNotFoundError
from play_launch.container.messages import Hello
from play_launch.container.ros import (
    NotInstalledError,
    component_container,
    ros_installation,
    spawn_guard,
)
from play_launch.process.cgroups.group import GroupError
from play_launch.process.child import INHERITED, spawn
from play_launch.process.guard import SessionGuard
from play_launch.process.identity import read_stat
from play_launch.process.kin import mark_for
from play_launch.process.machine import (
    SHARED_MEMORY_FIX,
    full_shared_memory,
    shared_memory_problem,
    shared_memory_room,
)
from play_launch.process.program import SpawnError
from play_launch.process.session import Shared
from play_launch.process.stop import StopPolicy, stop
from play_launch.recording.facts import OURSELVES, package_version
from play_launch.ros.fastdds.shared_memory import sweep_command, sweep_shared_memory
from play_launch.runtime.commands import (
    Machine,
    MemberGroups,
    ParameterFiles,
    StartError,
    allocator_for,
    container_command,
    container_environment,
    participants,
    probe_command,
    process_command,
    uses_fastdds,
)
from play_launch.runtime.probes import component_library

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from play_launch.config.model import (
        ComposableNodeConfig,
        ContainerConfig,
        ProcessConfig,
        ReplayConfig,
    )
    from play_launch.container.messages import Incoming, Outgoing
    from play_launch.process.child import Child
    from play_launch.process.exit import Exit
    from play_launch.process.lines import OutputCallback
    from play_launch.runtime.commands import Command
    from play_launch.runtime.stock_containers import StockContainers
    from play_launch.supervisor.events import GroupSample

_log = logging.getLogger(__name__)

_PASSING: Final = frozenset(
    {errno.EAGAIN, errno.ENOMEM, errno.EMFILE, errno.ENFILE, errno.EPIPE, errno.ECONNRESET}
)
"""Errors of a start that may not be there the next time."""


class ManagedProcess(Protocol):
    """`NativeProcess`, or the process of a container that another program started."""

    @property
    def pid(self) -> int: ...

    @property
    def start_time(self) -> int: ...

    @property
    def argv(self) -> tuple[str, ...]: ...

    async def wait(self) -> Exit: ...

    async def gone(self) -> Exit: ...

    def kill(self) -> None: ...

    async def stop(self, *, ask: Callable[[], bool] | None, hurry: asyncio.Event) -> bool: ...


class ControlLink(Protocol):
    """`ControlChannel`, or a stock container's services."""

    async def handshake(self, hello: Hello) -> Hello: ...

    async def receive(self) -> Incoming: ...

    def send(self, message: Outgoing) -> None: ...

    def close(self) -> None: ...


class NativeProcess:
    """A child and the policy that stops it."""

    def __init__(self, child: Child, policy: Callable[[], StopPolicy]) -> None:
        self.pid, self.start_time, self.argv = child.pid, child.start_time, child.argv
        self._child = child
        self._policy = policy

    async def wait(self) -> Exit:
        """Wait until the process itself has exited."""
        return await self._child.wait()

    async def gone(self) -> Exit:
        """Wait until its descendants have exited and its output is read, too."""
        return await self._child.gone()

    def kill(self) -> None:
        """Kill its group; the rest of its session follows when it has exited."""
        self._child.signal_group(signal.SIGKILL)

    async def stop(self, *, ask: Callable[[], bool] | None, hurry: asyncio.Event) -> bool:
        """Stop it and its session; False when not even SIGKILL did it in time."""
        outcome = await stop(self._child, self._policy(), ask=ask, hurry=hurry)
        if outcome.stragglers:
            _log.warning("%r left %d processes, killed", self._child, outcome.stragglers)
        return outcome.exit is not None


class NativeLauncher:
    """Starts containers of our own and ordinary executables of this machine."""

    def __init__(
        self,
        *,
        machine: Machine,
        guard: Path,
        policy: StopPolicy,
        parameters: ParameterFiles,
        stock: StockContainers | None = None,
        uses_fastdds: bool = True,
        publish: Callable[[GroupSample], None] = lambda _: None,
    ) -> None:
        """Take the facts about this machine, see `of`."""
        self._stock = stock
        self._uses_fastdds = uses_fastdds
        self._machine = machine
        self._guard_program = guard
        self._guards: list[SessionGuard] = []
        self._policy = policy
        self._parameters = parameters
        self._sweeps = Shared(self._sweep)
        self.groups = MemberGroups(publish)
        self._hello = Hello(
            version=package_version(OURSELVES) or "unknown",
            pid=os.getpid(),
            start_time=read_stat(os.getpid()).start_time,
        )

    @classmethod
    def of(
        cls, config: ReplayConfig, publish: Callable[[GroupSample], None] = lambda _: None
    ) -> NativeLauncher:
        """Find everything that the system needs; reads folders, writes files.

        ``publish`` takes the last numbers of control groups, in the loop's thread.

        Raises:
            NotInstalledError: When ROS or a program of ours is not there.
            MixedInstallationError: When ROS is there twice.
            GroupError: When there are no control groups, which are required.
        """
        ros = ros_installation()
        container, guard = component_container(), spawn_guard()
        is_fastdds = uses_fastdds(config, os.environ)
        short = is_fastdds and shared_memory_problem(shared_memory_room(), participants(config))
        if short:
            _log.warning("%s", short)
        launcher = cls(
            machine=Machine(ros, container, os.environ, _allocator(config)),
            guard=guard,
            policy=_policy(config),
            parameters=ParameterFiles((*config.containers, *config.nodes)),
            stock=_stock_containers(config),
            uses_fastdds=is_fastdds,
            publish=publish,
        )
        launcher.groups.prepare(config)
        return launcher

    async def prepare(self, config: ReplayConfig) -> None:
        """Get ready for what a changed system needs; raises StartError."""
        self._uses_fastdds = self._uses_fastdds or uses_fastdds(config, os.environ)
        members: tuple[ContainerConfig | ProcessConfig, ...] = (*config.containers, *config.nodes)
        await asyncio.to_thread(self._parameters.write, members)
        if self._machine.allocator is None:
            allocator = await asyncio.to_thread(_allocator, config)
            self._machine = replace(self._machine, allocator=allocator)
        try:
            await asyncio.to_thread(self.groups.prepare, config)
            if self._stock is None:
                self._stock = await asyncio.to_thread(_stock_containers, config)
            else:
                await asyncio.to_thread(self._stock.extend, config)
        except (GroupError, NotInstalledError) as error:
            raise StartError(str(error), permanent=True) from error
        self._policy = _policy(config)

    def hello(self) -> Hello:
        """Give the hello of the supervisor."""
        return self._hello

    async def start_container(
        self, config: ContainerConfig, on_output: OutputCallback
    ) -> tuple[ManagedProcess, ControlLink]:
        """Start a container, or attach to it, with a way to talk to it; raises StartError."""
        if config.attach:
            assert self._stock is not None
            return self._stock.attach(config)
        try:
            file = self._parameters.of(config)
            command = container_command(config, self._machine, file, ask=self._policy.ask)
        except ExecutableNotFoundError as error:
            raise StartError(str(error), permanent=True) from error
        if config.container_type is ContainerType.STOCK:
            assert self._stock is not None
            process = await self._spawn(command, on_output, config)
            try:
                return process, self._stock.talk_to(config, process)
            except Exception:
                process.kill()
                raise
        try:
            pair = control_pair()
        except OSError as error:
            raise StartError(f"no control channel: {error.strerror}", permanent=False) from error
        with ExitStack() as opened:
            opened.callback(pair.close)
            command = command.with_variables({CONTROL_FD_VARIABLE: str(INHERITED)})
            process = await self._spawn(command, on_output, config, control_fd=pair.child_fd)
            pair.close_child_end()
            opened.pop_all()
        return process, ControlChannel(pair.ours, container=config.full_name)

    async def library_of(self, container: ContainerConfig, node: ComposableNodeConfig) -> str:
        """Find the library in the ament index that the container uses; empty: it has none."""
        prefixes = ament_prefixes(container_environment(container, self._machine))
        found = await asyncio.to_thread(component_library, node.package, node.plugin, prefixes)
        return str(found or "")

    async def start_probe(
        self, container: ContainerConfig, node: ComposableNodeConfig, on_output: OutputCallback
    ) -> NativeProcess:
        """Start a scratch process like the container itself; raises StartError."""
        return await self._spawn(probe_command(container, node, self._machine), on_output)

    async def start_process(
        self, config: ProcessConfig, on_output: OutputCallback
    ) -> NativeProcess:
        """Start an ordinary executable; raises StartError."""
        try:
            command = process_command(config, self._machine, self._parameters.of(config))
        except (ExecutableNotFoundError, ValueError) as error:
            raise StartError(str(error), permanent=True) from error
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
    ) -> NativeProcess:
        group, entry = (None, ()) if config is None else self.groups.of(config)
        try:
            # One that is lost is kept: what it has started would end with it.
            if not (self._guards and self._guards[-1].is_alive):
                guard = SessionGuard.start(self._guard_program, afterwards=sweep_command())
                self._guards.append(guard)
            self.groups.entrust(self._guards[-1])
            child = await spawn(
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
            raise StartError(str(error), permanent=error.errno not in _PASSING) from error
        except OSError as error:
            raise StartError(f"no guard: {error.strerror}", permanent=False) from error
        return NativeProcess(child, lambda: self._policy)


def _policy(config: ReplayConfig) -> StopPolicy:
    limits = config.stop
    return StopPolicy(ask=limits.ask, sigint=limits.sigint, sigterm=limits.sigterm)


def _stock_containers(config: ReplayConfig) -> StockContainers | None:
    if all(each.container_type is not ContainerType.STOCK for each in config.containers):
        return None
    if problem := full_shared_memory(shared_memory_room()):
        # It may have filled up since the start. Loading rcl is what maps it, and SIGBUS would end
        # the supervisor without a word: no handler reaches the thread that gets it.
        raise NotInstalledError(f"{problem}; nothing was started; fix: {SHARED_MEMORY_FIX}")
    # A quarter of all modules of ours, for one type of container.
    from play_launch.runtime.stock_containers import StockContainers  # noqa: PLC0415

    return StockContainers.of(config)


def _allocator(config: ReplayConfig) -> Path | None:
    """Find what isolated containers allocate with; complain once for the whole system."""
    found = allocator_for(config)
    if found.problem:
        _log.warning("%s", found.problem)
    return found.library
