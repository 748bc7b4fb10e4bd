"""One member of the system: what is wanted of it, its process, one inbox.

Whatever happens to a member is handed to `Member.post` or `Member.deliver`: words of its container,
the end of its process, points in time, requests of others. One after the other is carried out at
once and to its end, so nobody else ever sees or changes a member halfway
(docs/decisions/member-inbox.md). What takes time runs in tasks that do nothing but hand over what
came of it.
"""

from __future__ import annotations

import asyncio
import logging
import random
from functools import partial
from typing import TYPE_CHECKING, Final, assert_never

import anyio

from play_launch.actors.death import Death
from play_launch.actors.failures import failure_reason
from play_launch.actors.inbox import Inbox
from play_launch.actors.ports import StartError
from play_launch.actors.process_reports import ProcessReports
from play_launch.actors.rest import Rest
from play_launch.actors.restarter import Restarter
from play_launch.actors.sources import Source, Sources
from play_launch.actors.turn import StartTurn
from play_launch.core.events import REPORTED_LOGGER, ContainerState, ProcessEventKind
from play_launch.core.member import MemberAction, MemberInput, MemberRecord, step

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from anyio.abc import TaskGroup

    from play_launch.actors.ports import ManagedProcess
    from play_launch.actors.publisher import Publisher
    from play_launch.actors.stop_requests import StopRequests
    from play_launch.core.restart import RestartLimits
    from play_launch.process.exit import Exit

_log = logging.getLogger(__name__)
_reported = logging.getLogger(REPORTED_LOGGER)

KILL_LIMIT: Final = 5.0
"""Seconds from SIGKILL to the end of a process; one in an uninterruptible system call lives on."""

LATE: Final = 5.0
"""Seconds after which what is due counts as forgotten."""

_AT_REST: Final = frozenset({ContainerState.STOPPED, ContainerState.GAVE_UP})
_ENDS: Final = frozenset({ContainerState.STOPPING, ContainerState.GAVE_UP})


class Member:
    """Owns one container or ordinary executable; times are seconds of the event loop's clock."""

    def __init__(
        self,
        name: str,
        *,
        restart: RestartLimits,
        publisher: Publisher,
        stop: StopRequests,
        turn: StartTurn | None = None,
        jitter: Callable[[], float] = random.random,
    ) -> None:
        """Know the member by its full name; it starts when it has its ``turn``."""
        self.name = name
        self._stop = stop
        self._loop = asyncio.get_running_loop()
        self._reports = ProcessReports(name, publisher)
        self._restarter = Restarter(restart, jitter)
        self._turn = turn or StartTurn()
        self._record = MemberRecord()
        self._inbox = Inbox(deadlines=self._deadlines, on_time=self._on_time, on_error=self._fail)
        self._sources = Sources(lambda error: self.deliver(partial(self._fail, error)))
        self._queued = Source()
        self.rest = Rest()
        self._restart_at: float | None = None
        self._delay = 0.0
        self._death_reason = ""
        self._stop_reason = ""
        # Of the latest process; it stays until nothing of it is left.
        self._process: ManagedProcess | None = None
        self._companion = Source()
        self._nothing_left = asyncio.Event()
        self._nothing_left.set()
        self._has_ended = False
        self._is_decided = False  # what follows from its end, whenever that comes
        self._killed_because = ""
        self._is_fatal = False
        self._kill_due: float | None = None
        self._is_stuck = False
        self._stopped: asyncio.Event | None = None

    @property
    def state(self) -> ContainerState:
        """What is known about it."""
        return self._record.state

    @property
    def wanted(self) -> bool:
        """Whether somebody wants it to run."""
        return self._record.wanted

    @property
    def is_at_rest(self) -> bool:
        """Whether it does not run, nothing is left of it, and it does not start by itself."""
        return self.rest.is_reached

    @property
    def is_stuck(self) -> bool:
        """Whether its process lives on although it was killed."""
        return self._is_stuck

    def ailment(self) -> str:
        """Say what nobody does for it that has to be done; empty: it is looked after."""
        if self._process is not None and not self._companion.runs and not self._is_stuck:
            return f"nobody waits for the end of its process {self._process.pid}"
        late = self._inbox.lateness()
        return f"what was due {late:.0f} s ago is not done" if late > LATE else ""

    def post(self, said: MemberInput, reason: str = "") -> None:
        """Hand over an input, with its reason where one is to be reported."""
        self.deliver(partial(self._apply, said, reason))

    def when_settled(self, callback: Callable[[], None]) -> None:
        """Have this called whenever something was done to it."""
        self._inbox.on_settled = callback

    def deliver(self, work: Callable[[], None]) -> None:
        """Have something done to this member, at once or after what is being done to it.

        Whatever it raises is this member's failure, and nobody else's.
        """
        self._inbox.deliver(work)

    def begin(self, tasks: TaskGroup) -> None:
        """Begin to carry out what is wanted: that it runs, unless the system stops already.

        What takes time runs in ``tasks``. When these are cancelled, no process is left behind.
        """
        self._sources.run_in(tasks)
        self._begin_sources()
        if not self._stop.requested.is_set():
            self.post(MemberInput.START)

    def close(self) -> None:
        """Do nothing at any later time."""
        self._inbox.close()

    # What a kind of member has to say.

    def _spawn(self) -> ManagedProcess:
        """Start its process; raises StartError."""
        raise NotImplementedError

    def _started(self) -> None:
        """Its process runs."""
        raise NotImplementedError

    def _death_of(self, exit_: Exit) -> Death:
        """Judge the end of its process."""
        raise NotImplementedError

    def _cannot_start(self, error: StartError) -> Death:
        """Judge that it could not be started."""
        raise NotImplementedError

    def _begin_sources(self) -> None:
        """Begin what runs as long as the member."""

    def _begin_work(self) -> None:
        """It is ready: put it to work."""

    def _lose(self, reason: str, *, comes_back: bool) -> None:
        """Whatever it did is over."""

    def _stops(self) -> None:
        """Its process is going to be stopped, or has ended: silence means nothing any more."""

    def _way_to_ask(self) -> Callable[[], bool] | None:
        """Give what asks it to stop in its own language."""
        return None

    async def _last_words(self) -> None:
        """Wait for what it said before its end."""

    def _let_go(self) -> None:
        """Nothing is heard of its process any more."""

    async def _clean_up(self) -> None:
        """Remove what its dead process left in the system, before the next one starts."""

    def _counts(self) -> bool:
        """Whether a restart uses up one of those that are allowed."""
        return True

    def _publish_state(self, reason: str) -> None:
        """Publish the state, where that is more than the process's own events."""

    def _deadlines(self) -> Iterator[float | None]:
        """Give the times at which `_on_time` has to be called; None for one that is not due."""
        yield self._kill_due
        yield self._restart_at if self._process is None else None

    def _on_time(self) -> None:
        now = self._loop.time()
        if self._kill_due is not None and now >= self._kill_due:
            self._kill_due = None
            self._apply(MemberInput.STUCK, self._stuck())
        if self._restart_at is not None and self._process is None and now >= self._restart_at:
            self._restart_at = None
            self._apply(MemberInput.RESTART_DUE)

    # The table, carried out.

    def _apply(self, said: MemberInput, reason: str = "") -> None:
        before = self._record
        self._record, actions = step(before, said)
        if self.state is not before.state:
            self._restart_at = None
            self._publish_state(reason)
        for action in actions:
            self._do(action, said, reason)
        self._look_whether_it_rests()

    def _do(self, action: MemberAction, said: MemberInput, reason: str) -> None:
        match action:
            case MemberAction.QUEUE:
                if said is not MemberInput.RESTART_DUE:
                    self._restarter.forget()
                self._queued = self._sources.begin(self._queue)
            case MemberAction.SPAWN:
                self._start()
            case MemberAction.BEGIN:
                self._turn.give_back()
                self._begin_work()
            case MemberAction.LOSE:
                self._lose(reason, comes_back=said is MemberInput.DIED_RESTART)
            case MemberAction.KILL:
                self._kill(reason, fatal=said is MemberInput.HELLO_MISMATCH)
            case MemberAction.STOP_PROCESS:
                self._stop_process(reason)
            case MemberAction.WAIT_FOR_RESTART:
                self._restart_at = self._loop.time() + self._delay
                _reported.warning("%s: %s", self.name, reason)
                self._publish(ProcessEventKind.RESTARTING, reason)
            case MemberAction.REPORT_GAVE_UP:
                if said is not MemberInput.FAILED:  # else it is logged with its call stack
                    again = " again" if self._reports.has_started else ""
                    _reported.error("%s is not started%s: %s", self.name, again, reason)
                self._publish(ProcessEventKind.GAVE_UP, reason)
            case _:
                assert_never(action)

    def _fail(self, error: Exception) -> None:
        """Give it up because of an exception of our own; what runs of it is stopped in order."""
        reason = failure_reason(error)
        _reported.error("%s: %s", self.name, reason, exc_info=error)
        before = self._record
        self._record, actions = step(before, MemberInput.FAILED)
        self._restart_at = self._kill_due = None
        publish = partial(self._publish_state, reason) if self.state is not before.state else None
        todo = [partial(self._do, action, MemberInput.FAILED, reason) for action in actions]
        for work in (publish, self._stops, *todo, self._look_whether_it_rests):
            try:
                if work is not None:
                    work()
            except Exception:  # noqa: BLE001 - it is logged, and the stop goes on
                _log.exception("%s: what follows from its failure failed as well", self.name)

    def _look_whether_it_rests(self) -> None:
        is_reached = self.state in _AT_REST and (self._process is None or self._is_stuck)
        self.rest.note(is_reached=is_reached, is_wanted=self.wanted)

    # A process, from its turn to its end.

    async def _queue(self) -> None:
        """Wait for its turn; cancelled when it is to stop instead."""
        queued = self._queued
        await self._nothing_left.wait()
        why = await self._turn.take()
        if queued.is_cancelled:
            self._turn.give_back()
        elif why:
            self.deliver(partial(self._die, Death(why, permanent=True)))
        else:
            self.post(MemberInput.SLOT)

    def _start(self) -> None:
        self._has_ended = False
        self._is_decided = False
        self._killed_because = ""
        self._is_fatal = False
        self._kill_due = None
        try:
            process = self._spawn()
        except StartError as error:
            self._die(self._cannot_start(error))
            return
        self._process = process
        self._nothing_left.clear()
        self._companion = self._sources.begin(partial(self._accompany, process))
        self._reports.started(process, self._restarter.total)
        self._started()

    async def _accompany(self, process: ManagedProcess) -> None:
        """See a process to its end."""
        try:
            await self._live(process)
        except Exception as error:  # noqa: BLE001 - others are not to pay for it
            self.deliver(partial(self._lose_sight, error))
            if self._stopped is not None:
                await self._stopped.wait()
        except BaseException:
            process.kill()
            raise
        finally:
            self._let_go()
            if not self._is_stuck:
                try:
                    await self._nothing_is_left_of(process)
                finally:
                    self.deliver(self._is_gone)

    async def _live(self, process: ManagedProcess) -> None:
        exit_ = await process.wait()
        self.deliver(partial(self._ended, exit_))
        await self._last_words()
        self._let_go()
        if not self._is_decided:
            self.deliver(lambda: self._die(self._death_of(exit_)))

    def _lose_sight(self, error: Exception) -> None:
        """Its end cannot be waited for: it is stopped, and nothing else follows."""
        self._fail(error)
        self._is_decided = True

    async def _nothing_is_left_of(self, process: ManagedProcess) -> None:
        with anyio.CancelScope(shield=True):
            if self._stopped is not None:
                await self._stopped.wait()
            await self._reports.gone(process)
        await self._clean_up()

    def _ended(self, exit_: Exit) -> None:
        self._has_ended = True
        self._is_stuck = False
        self._kill_due = None
        self._stops()
        self._reports.exited(exit_, self._restarter.total, self._killed_because)

    def _is_gone(self) -> None:
        self._process = None
        self._stopped = None
        self._turn.give_back()
        self._nothing_left.set()
        self._look_whether_it_rests()

    def _die(self, death: Death) -> None:
        """Decide what follows from the end of the process, or from a start that failed."""
        self._turn.give_back()
        self._is_decided = True
        self._kill_due = None
        self._death_reason = death.reason
        sequel = self._restarter.follow_up(
            death,
            now=self._loop.time(),
            is_over=self._is_fatal or self.state in _ENDS,
            counts=self._counts,
        )
        reason = sequel.reason
        if sequel.delay is not None:
            self._delay = sequel.delay
            reason = f"{reason}; {self._sequel(sequel.delay)}"
        elif sequel.said is MemberInput.ENDED and reason:
            _reported.warning("%s: stopped, and is not started again: %s", self.name, reason)
        self._apply(sequel.said, reason)

    def _sequel(self, delay: float) -> str:
        return f"starts again in {delay:.2f} s"

    def _kill(self, reason: str, *, fatal: bool) -> None:
        assert self._process is not None
        if self._has_ended:
            return  # it is dead already, and that is about to be decided upon
        _log.error("%s is killed: %s", self.name, reason)
        self._killed_because = reason
        self._is_fatal = fatal
        self._publish(ProcessEventKind.STOPPING, f"killed: {reason}")
        self._kill_due = self._loop.time() + KILL_LIMIT
        self._process.kill()

    def _stop_process(self, reason: str) -> None:
        self._stop_reason = reason
        self._queued.cancel()
        if self._process is None or self._is_decided:
            self._turn.give_back()
            self.post(MemberInput.DIED_FOR_GOOD, "it was stopped before it was started")
            return
        if self._stopped is not None:
            return
        self._kill_due = None
        ask = self._way_to_ask()
        self._stops()
        if not self._has_ended:
            self._publish(ProcessEventKind.STOPPING, reason)
        self._stopped = asyncio.Event()
        self._sources.begin(partial(self._stop_in_order, self._process, ask, self._stopped))

    async def _stop_in_order(
        self, process: ManagedProcess, ask: Callable[[], bool] | None, stopped: asyncio.Event
    ) -> None:
        """Stop it as gently as it allows, and kill it in the end; at once when that fails."""
        try:
            if not await process.stop(ask=ask, hurry=self._stop.hurry):
                self.deliver(lambda: self._apply(MemberInput.STUCK, self._stuck()))
        except Exception:  # noqa: BLE001 - it is logged, and the stop goes on
            _log.exception("%s could not be stopped in order and is killed", self.name)
            process.kill()
        finally:
            stopped.set()

    def _stuck(self) -> str:
        assert self._process is not None
        self._is_stuck = self._is_decided = True
        reason = "does not die, not even of SIGKILL"
        _log.error("%s (pid %d) %s", self.name, self._process.pid, reason)
        return reason

    def _publish(self, kind: ProcessEventKind, message: str) -> None:
        self._reports.publish(kind, self._restarter.total, message=message)
