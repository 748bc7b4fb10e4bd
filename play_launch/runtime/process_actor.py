"""One process at a time, from its start until nothing of it is left; and the tasks for that."""

from __future__ import annotations

import logging
from contextlib import suppress
from contextvars import Context, copy_context
from functools import partial
from importlib import import_module
from typing import TYPE_CHECKING, Final

import anyio
from msgspec.structs import replace

from play_launch.config.model import ProcessConfig
from play_launch.process.resources import held_resources, shortfalls
from play_launch.runtime.launcher import StartError
from play_launch.supervisor.inputs import CleanedUp, Exited, NotStarted, Started, Unkillable
from play_launch.supervisor.world import Exit, Phase

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Sequence

    from anyio.abc import TaskGroup

    from play_launch.config.model import ContainerConfig
    from play_launch.config.resources import Resources
    from play_launch.process.lines import Line
    from play_launch.runtime.launcher import ManagedProcess
    from play_launch.runtime.system import System
    from play_launch.supervisor.events import Stream

_log = logging.getLogger(__name__)

GONE_LIMIT: Final = 10.0
"""Seconds from the exit of a process to the end of its children and its output."""


class Tasks:
    """Tasks of a system: they wait, and post inputs. Belong to the thread of the event loop."""

    def __init__(self, fail: Callable[[str, Exception], None]) -> None:
        """``fail`` is called with the unit of a task that raised an exception."""
        self._fail = fail
        self._group: TaskGroup | None = None
        self._context = Context()

    def run_in(self, group: TaskGroup) -> None:
        """Run them in ``group`` from now on."""
        self._group = group
        self._context = copy_context()
        # Where sniffio is installed, anyio gets the event loop from it; outside of a task, as in a
        # callback of the loop, sniffio reads this variable only.
        with suppress(ModuleNotFoundError):
            sniffio = import_module("sniffio")
            self._context.run(sniffio.current_async_library_cvar.set, "asyncio")

    def scope(self) -> anyio.CancelScope:
        """Make a scope that a task enters later."""
        return self._context.copy().run(anyio.CancelScope)

    def begin(self, work: Callable[[], Awaitable[None]], unit: str = "") -> anyio.CancelScope:
        """Begin a task, whose exception is the failure of the unit alone; return its scope.

        Cancelled before it begins, it never does.
        """
        assert self._group is not None
        scope = self.scope()
        self._context.copy().run(self._group.start_soon, self._run, scope, work, unit)
        return scope

    async def _run(
        self, scope: anyio.CancelScope, work: Callable[[], Awaitable[None]], unit: str
    ) -> None:
        try:
            with scope:
                if not scope.cancel_called:
                    await work()
        except Exception as error:  # noqa: BLE001 - the other units go on
            self._fail(unit, error)


class ProcessActor:
    """Owns the process of one unit; posts what happens to it, and carries out effects."""

    def __init__(self, name: str, system: System) -> None:
        self.name = name
        self._system = system
        self._process: ManagedProcess | None = None
        self._start = 0
        self._spawning = system.tasks.scope()
        self._stopped: anyio.Event | None = None
        self._was_killed = False

    @property
    def pid(self) -> int:
        """Of its process; 0 without one."""
        return 0 if self._process is None else self._process.pid

    @property
    def config(self) -> ContainerConfig | ProcessConfig:
        """Of its unit."""
        return self._system.world.processes[self.name].config

    # Effects.

    def spawn(self, start: int) -> None:
        """Start its process."""
        self._start = start
        self._spawning = self._system.tasks.scope()
        self._system.tasks.begin(partial(self._live, start), self.name)

    def kill(self, start: int) -> None:
        """Kill its process, or give its start up, which is answered all the same."""
        if start != self._start:
            return
        if self._process is None:
            self._spawning.cancel()
        else:
            self._stops()
            self._process.kill()

    def stop(self, start: int, *, asks: bool, reason: str) -> None:
        """Stop its process, from gentle to hard."""
        if start != self._start or self._process is None or self._stopped is not None:
            return
        self._stops()
        ask = partial(self._ask_to_stop, reason) if asks else None
        self._stopped = anyio.Event()
        self._system.tasks.begin(
            partial(self._stop_in_order, self._process, start, ask, self._stopped), self.name
        )

    # What a kind of process has to say.

    async def _begin(self) -> ManagedProcess:
        """Start its process; raises StartError. Cancelled, it leaves none."""
        config = self.config
        assert isinstance(config, ProcessConfig)
        return await self._system.launcher.start_process(config, self._on_output)

    def _has_started(self, start: int) -> None:
        del start
        self._check(self.name, self.config.resources, self.pid)

    def _ask_to_stop(self, reason: str) -> bool:
        del reason
        return False

    def _stops(self) -> None:
        """Silence means nothing from now on."""

    async def _drained(self) -> None:
        """Wait for what it sent before its exit."""

    def _let_go(self) -> None:
        """Nothing is heard of its process any more."""

    async def _clean_up(self) -> None:
        """Remove what its process left in the system."""
        # Processes that publish to it, of this system or another, would go on writing into its
        # memory, and may deadlock there (docs/dds.md).
        if self._was_killed:
            await self._system.launcher.clean_up()

    def _check(self, name: str, wanted: Resources, pid: int) -> None:
        """Report once each resource that the kernel refused; the process runs without it."""
        held = held_resources(pid, wanted.limit_names) if wanted and pid else None
        for shortfall in () if held is None else shortfalls(wanted, held):
            text = f"{name}: {shortfall}"
            if self._system.publisher.is_news(text):
                _log.warning("%s", text)
        self._system.launcher.groups.check(name, pid)

    def _on_output(self, stream: Stream, lines: Sequence[Line]) -> None:
        self._system.publisher.publish_output(self.name, self.pid, stream, lines)

    # The life of a process.

    async def _live(self, start: int) -> None:
        """Start its process, and wait until nothing of it is left."""
        process = None
        failed = NotStarted(self.name, start, "its start was cancelled", is_permanent=False)
        with self._spawning:
            try:
                process = await self._begin()
            except StartError as error:
                failed = replace(failed, reason=str(error), is_permanent=error.permanent)
            except Exception as error:  # noqa: BLE001 - it is the failure of this unit alone
                self._system.fail(self.name, error)
                failed = replace(failed, reason=str(error), is_permanent=True)
        if process is None:
            self._system.post(failed)
        else:
            self._process, self._stopped = process, None
            await self._accompany(process, start)

    async def _accompany(self, process: ManagedProcess, start: int) -> None:
        """Wait until nothing of a process is left; cancelled, it is stopped in order."""
        identity = process.pid, process.start_time, process.argv
        try:
            self._system.post(Started(self.name, start, *identity))
            self._has_started(start)
            exit_ = await process.wait()
            await self._drained()
            self._let_go()
            phase = self._system.world.processes[self.name].phase
            is_requested = phase in {Phase.STOPPING, Phase.KILLING}
            self._was_killed = (exit_.signal != 0 or exit_.is_lost) and not is_requested
            exited = Exit(str(exit_), exit_.code, exit_.signal, exit_.is_lost)
            self._system.post(Exited(self.name, start, exited))
        except Exception as error:  # noqa: BLE001 - the others go on
            self._system.fail(self.name, error)
        except BaseException:
            with anyio.CancelScope(shield=True):
                if self._system.world.processes[self.name].is_stuck:
                    process.kill()
                else:
                    await self._stop_it(process, None)
            raise
        finally:
            self._let_go()
            if not self._system.world.processes[self.name].is_stuck:
                try:
                    await self._nothing_is_left_of(process)
                finally:
                    self._process = None
                    self._system.post(CleanedUp(self.name, start))

    async def _nothing_is_left_of(self, process: ManagedProcess) -> None:
        with anyio.CancelScope(shield=True):
            if self._stopped is not None:
                await self._stopped.wait()
            with anyio.move_on_after(GONE_LIMIT) as scope:
                await process.gone()
            if scope.cancelled_caught:
                text = "%s (pid %d): %g s after its end, something of it is left"
                _log.error(text, self.name, process.pid, GONE_LIMIT)
        await self._clean_up()

    async def _stop_it(self, process: ManagedProcess, ask: Callable[[], bool] | None) -> bool:
        policy, hurry = self._system.launcher.policy, self._system.stop_requests.hurry
        return await process.stop(policy, ask=ask, hurry=hurry)

    async def _stop_in_order(
        self,
        process: ManagedProcess,
        start: int,
        ask: Callable[[], bool] | None,
        stopped: anyio.Event,
    ) -> None:
        """Stop it as gently as it allows; at once when that fails."""
        try:
            if not await self._stop_it(process, ask):
                self._system.post(Unkillable(self.name, start))
        except Exception:  # noqa: BLE001 - it is logged, and the stop goes on
            _log.exception("%s could not be stopped in order and is killed", self.name)
            process.kill()
        finally:
            stopped.set()
