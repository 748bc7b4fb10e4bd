"""Real processes and control channels for the actors."""

from __future__ import annotations

import asyncio
import errno
import logging
import os
import shutil
import signal
import tempfile
from contextlib import ExitStack
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Final

from play_launch.actors import head_start
from play_launch.actors.ports import StartError
from play_launch.config.model import ContainerType, Isolation
from play_launch.fastdds.middleware import asks_for_fastdds
from play_launch.fastdds.shared_memory import sweep_shared_memory
from play_launch.install.allocator import find_allocator, for_isolation
from play_launch.install.command import (
    ExecutableNotFoundError,
    container_argv,
    find_executable,
    probe_argv,
    process_argv,
    stock_container_argv,
)
from play_launch.install.component_index import component_library
from play_launch.install.environment import child_environment, foreign_python_environment
from play_launch.install.parameter_file import ParameterFileError, write_parameter_file
from play_launch.install.ros import (
    NotInstalledError,
    ament_prefixes,
    component_container,
    ros_installation,
    spawn_guard,
)
from play_launch.process.child import SpawnError, spawn
from play_launch.process.guard import SessionGuard
from play_launch.process.identity import read_stat
from play_launch.process.machine import (
    SHARED_MEMORY_FIX,
    full_shared_memory,
    shared_memory_problem,
    shared_memory_room,
)
from play_launch.process.stop import StopPolicy, stop
from play_launch.wire.channel import ControlChannel, control_pair
from play_launch.wire.messages import Hello

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from play_launch.actors.ports import ControlLink, ManagedProcess
    from play_launch.actors.stock.starter import StockContainers
    from play_launch.config.model import (
        ComposableNodeConfig,
        ContainerConfig,
        ProcessConfig,
        ReplayConfig,
    )
    from play_launch.install.ros import RosInstallation
    from play_launch.process.child import Child
    from play_launch.process.exit import Exit
    from play_launch.process.lines import OutputCallback
    from play_launch.process.zygote import Zygote

_log = logging.getLogger(__name__)

_DISTRIBUTION: Final = "play-launch-py"
_CONTAINER_SHARE: Final = 0.6
"""Part of the time for asking that the container gives its nodes; the rest is its own."""
_PASSING: Final = frozenset(
    {errno.EAGAIN, errno.ENOMEM, errno.EMFILE, errno.ENFILE, errno.EPIPE, errno.ECONNRESET}
)
"""Errors of a start that may not be there the next time."""


class NativeProcess:
    """A child and the policy that stops it."""

    def __init__(self, child: Child, policy: StopPolicy) -> None:
        """Own a child."""
        self._child = child
        self._policy = policy

    @property
    def pid(self) -> int:
        """Its pid."""
        return self._child.pid

    @property
    def start_time(self) -> int:
        """Clock ticks after boot."""
        return self._child.start_time

    @property
    def argv(self) -> tuple[str, ...]:
        """Its command line."""
        return self._child.argv

    async def wait(self) -> Exit:
        """Wait until the process itself has ended."""
        return await self._child.wait()

    async def gone(self) -> Exit:
        """Wait until nothing of it is left."""
        return await self._child.gone()

    def kill(self) -> None:
        """Kill its group; the rest of its session follows when it has ended."""
        self._child.signal_group(signal.SIGKILL)

    async def stop(self, *, ask: Callable[[], bool] | None, hurry: asyncio.Event) -> bool:
        """Stop it and its session; False when not even SIGKILL did it in time."""
        outcome = await stop(self._child, self._policy, ask=ask, hurry=hurry)
        if outcome.stragglers:
            _log.warning("%r left %d processes, killed", self._child, outcome.stragglers)
        return outcome.exit is not None


class NativeLauncher:
    """Starts containers of our own and ordinary executables of this machine."""

    def __init__(
        self,
        *,
        ros: RosInstallation,
        container: Path,
        guard: Path,
        policy: StopPolicy,
        parameters: ParameterFiles,
        stock: StockContainers | None = None,
        allocator: Path | None = None,
        uses_fastdds: bool = True,
        containers: Iterable[str] = (),
    ) -> None:
        """Take the facts about this machine, see `of`."""
        self._stock = stock
        self._allocator = allocator
        self._uses_fastdds = uses_fastdds
        self._ros = ros
        self._container = container
        self._guard_program = guard
        begun = head_start.take()
        self._guards = [begun.guard] if begun.guard is not None else []
        self._zygotes = begun.zygotes
        self._not_started = set(containers)
        self._policy = policy
        self._parameters = parameters
        self._cleaning = asyncio.Lock()
        self._hello = Hello(
            version=_version(),
            pid=os.getpid(),
            start_time=read_stat(os.getpid()).start_time,
        )

    @classmethod
    def of(cls, config: ReplayConfig) -> NativeLauncher:
        """Find everything that the system needs; reads folders, writes files.

        Raises:
            NotInstalledError: When ROS or a program of ours is not there.
            MixedInstallationError: When ROS is there twice.
        """
        ros = ros_installation()
        container, guard = component_container(), spawn_guard()
        uses_fastdds = _uses_fastdds(config)
        if uses_fastdds:
            _complain_of_shared_memory(config)
        limits = config.stop
        policy = StopPolicy(ask=limits.ask, sigint=limits.sigint, sigterm=limits.sigterm)
        return cls(
            ros=ros,
            container=container,
            guard=guard,
            policy=policy,
            parameters=ParameterFiles(config.nodes),
            stock=_stock_containers(config),
            allocator=_allocator(config),
            uses_fastdds=uses_fastdds,
            containers=_own_containers(config),
        )

    def hello(self) -> Hello:
        """Say who we are."""
        return self._hello

    def start_container(
        self, config: ContainerConfig, on_output: OutputCallback
    ) -> tuple[ManagedProcess, ControlLink]:
        """Start a container, or attach to it, with a way to talk to it; raises StartError."""
        if config.attach:
            assert self._stock is not None
            return self._stock.attach(config)
        if config.container_type is ContainerType.STOCK:
            assert self._stock is not None
            process = self._start_stock(config, on_output)
            return process, self._stock.talk_to(config, process)
        argv = container_argv(
            config, self._container, stop_timeout=self._policy.ask * _CONTAINER_SHARE
        )
        environment = self._environment(config)
        try:
            pair = control_pair()
        except OSError as error:
            raise StartError(f"no control channel: {error.strerror}", permanent=False) from error
        with ExitStack() as opened:
            opened.callback(pair.close)
            process = self._spawn(
                argv, environment | pair.environment, on_output, control_fd=pair.child_fd
            )
            pair.close_child_end()
            opened.pop_all()
        self._started(config)
        return process, ControlChannel(pair.ours, container=config.full_name)

    def _started(self, config: ContainerConfig) -> None:
        self._not_started.discard(config.full_name)
        if not self._not_started:
            # One that is started again is executed: its memory is laid out anew.
            self._end_zygotes()

    def _zygote(self, program: str, environment: Mapping[str, str]) -> Zygote | None:
        able = (each for each in self._zygotes if each.can_become(program, environment))
        return next(able, None)

    def _end_zygotes(self) -> None:
        for zygote in self._zygotes:
            zygote.close()

    async def library_of(self, container: ContainerConfig, node: ComposableNodeConfig) -> str:
        """Find the library in the ament index that the container uses; empty: it has none."""
        prefixes = ament_prefixes(self._environment(container))
        found = await asyncio.to_thread(component_library, node.package, node.plugin, prefixes)
        return str(found or "")

    def start_probe(
        self, container: ContainerConfig, node: ComposableNodeConfig, on_output: OutputCallback
    ) -> NativeProcess:
        """Start a scratch process like the container itself; raises StartError."""
        argv = probe_argv(node.package, node.plugin, self._container)
        return self._spawn(argv, self._environment(container), on_output)

    def _environment(self, config: ContainerConfig) -> dict[str, str]:
        environment = child_environment(os.environ, self._ros, config.environment)
        if _shares_memory(config):
            environment = for_isolation(environment, self._allocator)
        return environment

    def _start_stock(self, config: ContainerConfig, on_output: OutputCallback) -> NativeProcess:
        environment = child_environment(os.environ, self._ros, config.environment)
        try:
            prefixes = ament_prefixes(environment)
            program = find_executable(config.package, config.executable, prefixes)
        except ExecutableNotFoundError as error:
            raise StartError(str(error), permanent=True) from error
        return self._spawn(stock_container_argv(config, program), environment, on_output)

    def start_process(self, config: ProcessConfig, on_output: OutputCallback) -> NativeProcess:
        """Start an ordinary executable; raises StartError."""
        environment = child_environment(os.environ, self._ros, config.environment)
        try:
            argv = process_argv(
                config,
                executable=_executable(config, environment),
                parameter_file=self._parameters.of(config),
            )
        except (ExecutableNotFoundError, ValueError) as error:
            raise StartError(str(error), permanent=True) from error
        program = shutil.which(argv[0], path=environment.get("PATH"))
        if program is not None:
            environment = foreign_python_environment(environment, self._ros, Path(program))
        return self._spawn(argv, environment, on_output)

    async def clean_up(self) -> None:
        """Remove the shared memory that killed processes left behind, where Fast DDS is in use."""
        if not self._uses_fastdds:
            return
        async with self._cleaning:
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
        self._end_zygotes()
        for guard in self._guards:
            await asyncio.to_thread(guard.close)
        if self._stock is not None and self._stock.is_open:
            await asyncio.to_thread(self._stock.close)
            # As long as we took part ourselves, we held what dead containers had left.
            await self.clean_up()

    def _spawn(
        self,
        argv: Sequence[str],
        environment: Mapping[str, str],
        on_output: OutputCallback,
        *,
        control_fd: int | None = None,
    ) -> NativeProcess:
        try:
            # One that is lost is kept: what it has started would end with it.
            if not (self._guards and self._guards[-1].is_alive):
                self._end_zygotes()
                self._guards.append(SessionGuard.start(self._guard_program))
            child = spawn(
                argv,
                env=environment,
                guard=self._guards[-1],
                pass_fds=() if control_fd is None else (control_fd,),
                on_output=on_output,
                # Our containers end in order when their control channel does.
                leaves_by_itself=control_fd is not None,
                zygote=self._zygote(argv[0], environment) if control_fd is not None else None,
            )
        except SpawnError as error:
            raise StartError(str(error), permanent=error.errno not in _PASSING) from error
        except OSError as error:
            raise StartError(f"no guard: {error.strerror}", permanent=False) from error
        return NativeProcess(child, self._policy)


class ParameterFiles:
    """The parameters of the ordinary nodes, each in a file of its own."""

    def __init__(self, configs: Iterable[ProcessConfig]) -> None:
        """Write the files; what cannot be written is reported when the file is asked for."""
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        self._paths: dict[str, Path | StartError] = {}
        for config in configs:
            if config.parameters:
                self._paths[config.full_name] = self._write(config)

    def of(self, config: ProcessConfig) -> Path | None:
        """Give the file; None when there are no parameters.

        Raises:
            StartError: When a file cannot express them, or could not be written.
        """
        path = self._paths.get(config.full_name)
        if isinstance(path, StartError):
            raise path
        return path

    def remove(self) -> None:
        """Remove the files; may be called twice."""
        if self._folder is not None:
            self._folder.cleanup()

    def _write(self, config: ProcessConfig) -> Path | StartError:
        try:
            if self._folder is None:
                self._folder = tempfile.TemporaryDirectory(prefix="play-launch-")
            return write_parameter_file(config.parameters, Path(self._folder.name))
        except ParameterFileError as error:
            return StartError(str(error), permanent=True)
        except OSError as error:
            reason = f"its parameters cannot be written to a temporary file: {error.strerror}"
            fix = "free some space, or set TMPDIR to another folder"
            return StartError(f"{reason}; {fix}", permanent=True)


def _stock_containers(config: ReplayConfig) -> StockContainers | None:
    if not any(each.container_type is ContainerType.STOCK for each in config.containers):
        return None
    if problem := full_shared_memory(shared_memory_room()):
        # It may have filled up since the start. Loading rcl is what maps it, and SIGBUS would end
        # the supervisor without a word: no handler reaches the thread that gets it.
        raise NotInstalledError(f"{problem}; nothing was started; fix: {SHARED_MEMORY_FIX}")
    # A quarter of all modules of ours, for one type of container.
    from play_launch.actors.stock.starter import StockContainers  # noqa: PLC0415

    return StockContainers.of(config)


def _own_containers(config: ReplayConfig) -> Iterable[str]:
    return (
        each.full_name
        for each in config.containers
        if not each.attach and each.container_type is not ContainerType.STOCK
    )


def _shares_memory(config: ContainerConfig) -> bool:
    return config.container_type.is_isolated and config.isolation is not Isolation.PROCESS


def _uses_fastdds(config: ReplayConfig) -> bool:
    declared = (
        *(each.environment for each in config.containers),
        *(each.environment for each in config.nodes),
    )
    return any(asks_for_fastdds({**os.environ, **each}) for each in declared)


def _complain_of_shared_memory(config: ReplayConfig) -> None:
    processes = len(config.containers) + len(config.nodes)
    # A node with memory of its own is a participant of its own; the others share their container's.
    apart = (
        each
        for each in config.containers
        if each.container_type.is_isolated and not _shares_memory(each)
    )
    participants = processes + sum(len(each.composable_nodes) for each in apart)
    if problem := shared_memory_problem(shared_memory_room(), participants):
        _log.warning("%s", problem)


def _allocator(config: ReplayConfig) -> Path | None:
    """Find what isolated containers allocate with; complain once for the whole system."""
    if not any(_shares_memory(container) for container in config.containers):
        return None
    found = find_allocator()
    if found.problem:
        _log.warning("%s", found.problem)
    return found.library


def _executable(config: ProcessConfig, environment: Mapping[str, str]) -> Path | None:
    if config.command is not None or config.package is None or config.executable is None:
        return None
    return find_executable(config.package, config.executable, ament_prefixes(environment))


def _version() -> str:
    try:
        return metadata.version(_DISTRIBUTION)
    except metadata.PackageNotFoundError:
        return "unknown"
