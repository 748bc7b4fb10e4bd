"""One ordinary executable."""

from __future__ import annotations

import asyncio
import logging
import random
from typing import TYPE_CHECKING, Final

from play_launch.actors.deadline import happens_before
from play_launch.actors.failures import failure_reason, stop_in_order
from play_launch.actors.ports import StartError
from play_launch.actors.process_reports import ProcessReports
from play_launch.actors.restarter import Restarter
from play_launch.core.events import TOLD_LOGGER, ProcessEventKind
from play_launch.core.restart import PERMANENT_EXIT_CODES, GiveUp

if TYPE_CHECKING:
    from collections.abc import Callable

    from play_launch.actors.ports import Launcher, ManagedProcess
    from play_launch.actors.publisher import Publisher
    from play_launch.actors.stop_requests import StopRequests
    from play_launch.config.model import ProcessConfig
    from play_launch.process.exit import Exit

_log = logging.getLogger(__name__)
_told = logging.getLogger(TOLD_LOGGER)

_NEVER_RAN: Final = frozenset({126, 127})
"""Exit codes that say that the program itself was not executed."""


class ProcessActor:
    """Owns one executable from the beginning of the run to its end."""

    def __init__(
        self,
        config: ProcessConfig,
        *,
        launcher: Launcher,
        publisher: Publisher,
        stop: StopRequests,
        jitter: Callable[[], float] = random.random,
    ) -> None:
        """Know the executable."""
        self._config = config
        self._name = config.full_name
        self._launcher = launcher
        self._stop = stop
        self._loop = asyncio.get_running_loop()
        self._reports = ProcessReports(self._name, publisher)
        self._restarter = Restarter(config.restart, jitter)

    async def run(self) -> None:
        """Run it until it ends for good or the system stops.

        An unexpected exception of our own stops this process alone, in order, for good.
        """
        try:
            await self._keep_running()
        except Exception as error:  # noqa: BLE001 - whatever it is, others are not to pay for it
            self._fail(error)

    async def _keep_running(self) -> None:
        while not self._stop.requested.is_set():
            began = self._loop.time()
            reason = await self._live()
            if reason is None or self._stop.requested.is_set():
                return
            verdict = self._restarter.decide(now=self._loop.time(), lived=self._loop.time() - began)
            if isinstance(verdict, GiveUp):
                self._give_up(f"{reason}; {verdict.reason}")
                return
            message = f"{reason}; starts again in {verdict.delay:.2f} s"
            _told.warning("%s: %s", self._name, message)
            self._reports.restarts = self._restarter.total
            self._reports.publish(ProcessEventKind.RESTARTING, message=message)
            await happens_before(self._stop.requested, self._loop.time() + verdict.delay)

    async def _live(self) -> str | None:
        """Run one process to its end; give the reason for a respawn, None without a respawn."""
        try:
            process = self._launcher.start_process(self._config, self._reports.on_output)
        except StartError as error:
            if error.permanent or not self._config.respawn:
                self._give_up(str(error))
                return None
            return str(error)
        try:
            exit_ = await self._live_with(process)
        except BaseException:
            process.kill()
            await self._reports.gone(process)
            raise
        if exit_ is None:
            return None
        await self._reports.gone(process)
        if not self._config.respawn:
            return None
        if exit_.code in _NEVER_RAN:
            self._give_up(f"{exit_}: {PERMANENT_EXIT_CODES[exit_.code]}")
            return None
        return str(exit_)

    async def _live_with(self, process: ManagedProcess) -> Exit | None:
        try:
            self._reports.started(process)
            return await self._accompany(process)
        except Exception as error:  # noqa: BLE001 - see `run`
            self._fail(error)
            await stop_in_order(process, ask=None, hurry=self._stop.hurry)
            return None

    async def _accompany(self, process: ManagedProcess) -> Exit | None:
        """See one process to its end; None when it does not die."""
        ended = asyncio.Event()
        async with asyncio.TaskGroup() as tasks:
            ending = tasks.create_task(process.wait())
            stopping = tasks.create_task(self._stop_when_requested(process, ended))
            await asyncio.wait({ending, stopping}, return_when=asyncio.FIRST_COMPLETED)
            if stopping.done() and not stopping.result():
                _log.error("%s (pid %d) does not die, not even of SIGKILL", self._name, process.pid)
                ending.cancel()
                return None
            exit_ = await ending
            ended.set()
            self._reports.exited(exit_)
            if self._stop.requested.is_set():
                await stopping
            stopping.cancel()
        return exit_

    async def _stop_when_requested(self, process: ManagedProcess, ended: asyncio.Event) -> bool:
        """Stop it as soon as that is requested; tell whether it has ended."""
        await self._stop.requested.wait()
        if not ended.is_set():
            self._reports.publish(ProcessEventKind.STOPPING, message=self._stop.reason)
        return await process.stop(ask=None, hurry=self._stop.hurry)

    def _fail(self, error: Exception) -> None:
        """Give it up because of an exception of our own; what runs of it is stopped in order."""
        reason = failure_reason(error)
        _told.error("%s: %s", self._name, reason, exc_info=error)
        try:
            self._reports.publish(ProcessEventKind.GAVE_UP, message=reason)
        except Exception:  # noqa: BLE001 - it is logged, and the stop goes on
            _log.exception("%s: its failure cannot be published", self._name)

    def _give_up(self, reason: str) -> None:
        _told.error("%s is not started again: %s", self._name, reason)
        self._reports.publish(ProcessEventKind.GAVE_UP, message=reason)
