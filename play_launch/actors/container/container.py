"""One container: its process, its control channel and, mirrored, its nodes."""

from __future__ import annotations

import asyncio
import logging
import random
from contextlib import ExitStack
from functools import partial
from typing import TYPE_CHECKING

from play_launch.actors.container.death import STOPPED_EARLY, Death, death_of
from play_launch.actors.container.hello import description, what_is_lacking
from play_launch.actors.container.limits import LIMITS, Limits
from play_launch.actors.container.nodes import AttemptNumbers, ContainerNodes
from play_launch.actors.container.watch import ContainerWatch
from play_launch.actors.deadline import acquired_before, first_of, happens_before
from play_launch.actors.failures import failure_reason, stop_in_order
from play_launch.actors.ports import StartError
from play_launch.actors.process_reports import ProcessReports
from play_launch.actors.restarter import Restarter
from play_launch.core.container_lifecycle import (
    TABLE,
    ContainerAction,
    ContainerInput,
)
from play_launch.core.events import (
    TOLD_LOGGER,
    ContainerState,
    ProcessEventKind,
)
from play_launch.core.lifecycle import Patience
from play_launch.core.restart import GiveUp
from play_launch.wire.channel import (
    ChannelClosedError,
    ControlError,
    IncompatibleError,
)
from play_launch.wire.messages import Hello, Shutdown, Status

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable

    from play_launch.actors.container.library_probes import LibraryProbes
    from play_launch.actors.ports import ControlLink, Launcher, ManagedProcess
    from play_launch.actors.publisher import Publisher
    from play_launch.actors.stop_requests import StopRequests
    from play_launch.config.model import ContainerConfig

_log = logging.getLogger(__name__)
_told = logging.getLogger(TOLD_LOGGER)


class ContainerActor:
    """Owns one container from the beginning of the run to its end."""

    def __init__(
        self,
        config: ContainerConfig,
        *,
        launcher: Launcher,
        publisher: Publisher,
        stop: StopRequests,
        attempts: AttemptNumbers,
        starts: asyncio.Semaphore,
        probes: LibraryProbes | None = None,
        limits: Limits = LIMITS,
        jitter: Callable[[], float] = random.random,
    ) -> None:
        """Know the container; ``starts`` bounds how many start up at the same time.

        ``probes`` loads libraries in scratch processes; None where the container is not our own.
        """
        self._config = config
        self._name = config.full_name
        self._launcher = launcher
        self._publisher = publisher
        self._stop = stop
        self._starts = starts
        self._limits = limits
        self._loop = asyncio.get_running_loop()
        self._reports = ProcessReports(self._name, publisher)
        self._restarter = Restarter(config.restart, jitter)
        self._delay = 0.0
        self._state = ContainerState.STOPPED
        self._nodes = ContainerNodes(
            config,
            publisher=publisher,
            escalation=self,
            attempts=attempts,
            patience=Patience(
                loading_timeout=config.loading_timeout, report_interval=limits.report_interval
            ),
            clock=self._loop.time,
            jitter=jitter,
            silence=limits.silence,
            probes=probes,
        )
        self._watch = ContainerWatch(self._name, clock=self._loop.time, limits=limits.watch)
        self._deadlines_changed = asyncio.Event()
        self._stopping = asyncio.Event()
        self._stop_reason = ""
        self._can_be_asked = False
        self._death_reason = ""
        # Of the present process:
        self._process: ManagedProcess | None = None
        self._ended = False
        self._killed_because = ""
        self._mechanism = ""
        self._blames_loads = True
        self._link: ControlLink | None = None
        self._hello_due: float | None = None
        self._ready_at: float | None = None

    @property
    def state(self) -> ContainerState:
        """What is known about the container."""
        return self._state

    def announce(self) -> None:
        """Tell that it and its nodes are declared."""
        self._publish_state("")
        self._nodes.announce()

    def unload(self, index: int) -> None:
        """Have a node unloaded, by its place in the declaration; it stays unloaded."""
        self._nodes.unload(index)
        self._deadlines_changed.set()

    def stop_container(self, reason: str) -> None:
        """Stop it for good, while the rest of the system runs on."""
        self._begin_stop(reason)

    def shut_down(self, reason: str) -> None:
        """Stop the whole system."""
        self._stop.request(reason=reason)

    def reload_hangs(self, reason: str) -> None:
        """Start it anew if it may hold the lock of a dead node; else the node is just slow."""
        if self._watch.may_hold_dead_locks:
            self._poisoned(f"a dead node may have left a lock: {reason}")

    def _look_for_dead_locks(self) -> None:
        if waiting := self._watch.waits_for_the_dead:
            self._poisoned(f"a node died with a lock: {waiting}")
            return
        limit = self._limits.reload_after_leak
        if self._watch.probably_holds_dead_locks and (name := self._nodes.slow_reload(limit)):
            self._poisoned(f"{name} is not loaded again, and cleaning up after a dead node failed")

    def _poisoned(self, reason: str) -> None:
        """Have it restarted because of a node that died, so not because of one that is loaded."""
        self._blames_loads = False
        self._apply(ContainerInput.FROZEN, reason)

    async def run(self) -> None:
        """Keep it running until the system stops, or it is given up: also after a fault of ours."""
        async with asyncio.TaskGroup() as tasks:
            probing = tasks.create_task(self._or_fail(self._nodes.suspects.run))
            await self._or_fail(self._keep_running)
            probing.cancel()

    async def _or_fail(self, part: Callable[[], Awaitable[None]]) -> None:
        try:
            await part()
        except Exception as error:  # noqa: BLE001 - whatever it is, others are not to pay for it
            self._fail(error)

    def _fail(self, error: Exception) -> None:
        """Give it up because of an exception of our own; what runs of it is stopped in order."""
        reason = failure_reason(error)
        _told.error("%s: %s", self._name, reason, exc_info=error)
        self._can_be_asked |= self._state is ContainerState.RUNNING
        self._stop_reason = self._stop_reason or reason
        try:
            self._apply(ContainerInput.FAILED, reason)
            self._watch.end()
            self._nodes.container_stops()
        except Exception:  # noqa: BLE001 - it is logged, and the stop goes on
            _log.exception("%s: its failure cannot be published", self._name)
        self._stopping.set()

    async def _keep_running(self) -> None:
        actions = self._apply(ContainerInput.START_REQUESTED)
        while ContainerAction.SPAWN in actions:
            death = await self._live()
            if ContainerAction.WAIT_FOR_RESTART not in self._die(death):
                break
            due = self._loop.time() + self._delay
            await self._gone()
            # A lock that a killed participant left would keep the next one waiting.
            await self._launcher.clean_up()
            if await happens_before(self._stop.requested, due):
                actions = self._apply(ContainerInput.STOP_REQUESTED)
            else:
                actions = self._apply(ContainerInput.RESTART_DUE)
        await self._gone()

    async def _live(self) -> Death:
        """Run one process from its start to its end."""
        with ExitStack() as starting:
            if not await acquired_before(self._stop.requested, self._starts):
                self._apply(ContainerInput.STOP_REQUESTED)
                return STOPPED_EARLY
            starting.callback(self._starts.release)
            try:
                process, link = self._launcher.start_container(
                    self._config, self._reports.on_output
                )
            except StartError as error:
                return Death(str(error), permanent=error.permanent)
            self._process, self._link = process, link
            try:
                return await self._live_with(process, link, starting)
            except BaseException:
                process.kill()
                await self._gone()
                raise
            finally:
                link.close()
                self._link = None
                self._watch.end()

    async def _live_with(
        self, process: ManagedProcess, link: ControlLink, starting: ExitStack
    ) -> Death:
        try:
            self._started(process)
            return await self._accompany(process, link, starting)
        except Exception as error:  # noqa: BLE001 - see `run`
            self._fail(error)
            await stop_in_order(process, ask=self._way_to_ask(), hurry=self._stop.hurry)
            return Death(failure_reason(error), permanent=True)

    async def _accompany(
        self, process: ManagedProcess, link: ControlLink, starting: ExitStack
    ) -> Death:
        said_everything = asyncio.Event()
        async with asyncio.TaskGroup() as tasks:
            listen = partial(self._listen, link, starting, said_everything)
            talking = tasks.create_task(self._or_fail(listen))
            waiting = tasks.create_task(self._or_fail(self._watch_deadlines))
            ending = tasks.create_task(process.wait())
            stopping = tasks.create_task(self._stop_when_requested(process))
            await asyncio.wait({ending, stopping}, return_when=asyncio.FIRST_COMPLETED)
            immortal = stopping.done() and not stopping.result()
            if not immortal:
                exit_ = await ending
                self._ended = True
                self._watch.end()
                self._reports.exited(exit_, self._killed_because)
                # What it said last is still in the socket.
                limit = self._loop.time() + self._limits.last_words
                await happens_before(said_everything, limit)
            for task in (talking, waiting, ending):
                task.cancel()
            if self._stopping.is_set():
                await stopping
            stopping.cancel()
        return (
            self._immortal(process)
            if immortal
            else death_of(ending.result(), self._killed_because, self._lived())
        )

    async def _listen(
        self, link: ControlLink, starting: ExitStack, said_everything: asyncio.Event
    ) -> None:
        """Hear what the container says, up to the end of the channel."""
        try:
            hello = await link.handshake(self._launcher.hello())
            starting.close()
            self._greeted(link, hello)
            while True:
                message = await link.receive()
                if isinstance(message, Hello):
                    _log.warning("%s said hello again", self._name)
                elif isinstance(message, Status) and self._watch.hear(message):
                    self._look_for_dead_locks()
                    self._nodes.hear_silence(message.nodes)
                    self._deadlines_changed.set()
                else:
                    self._nodes.hear(message)
                    self._deadlines_changed.set()
        except IncompatibleError as error:
            self._apply(ContainerInput.HELLO_MISMATCH, str(error))
        except ChannelClosedError as error:
            said_everything.set()
            # The channel ends a moment before the process does.
            await asyncio.sleep(self._limits.exit_after_close)
            self._apply(ContainerInput.CHANNEL_BROKEN, str(error))
        except ControlError as error:
            self._apply(ContainerInput.CHANNEL_BROKEN, str(error))
        finally:
            said_everything.set()

    async def _watch_deadlines(self) -> None:
        while True:
            self._deadlines_changed.clear()
            times = (
                self._hello_due,
                self._nodes.next_deadline(),
                self._watch.next_deadline(),
            )
            due = min((time for time in times if time is not None), default=None)
            if await happens_before(self._deadlines_changed, due):
                continue
            if self._hello_due is not None and self._loop.time() >= self._hello_due:
                self._hello_due = None
                reason = f"it did not say hello within {self._limits.hello:g} s"
                self._apply(ContainerInput.HELLO_OVERDUE, reason)
            if frozen := self._watch.on_time():
                self._apply(ContainerInput.FROZEN, frozen)
            self._nodes.on_time()

    async def _stop_when_requested(self, process: ManagedProcess) -> bool:
        """Stop it as soon as that is requested; tell whether it has ended."""
        await first_of(self._stop.requested.wait(), self._stopping.wait())
        if not self._begin_stop(self._stop.reason):
            await process.wait()
            return True
        return await process.stop(ask=self._way_to_ask(), hurry=self._stop.hurry)

    def _begin_stop(self, reason: str) -> bool:
        """Begin to stop the process, once; False when there is none that could be stopped."""
        if self._stopping.is_set():
            return True
        is_running = self._state is ContainerState.RUNNING
        self._stop_reason = reason
        if ContainerAction.STOP_PROCESS not in self._apply(ContainerInput.STOP_REQUESTED, reason):
            return False
        self._can_be_asked = is_running
        self._watch.end()
        self._nodes.container_stops()
        if not self._ended:
            self._reports.publish(ProcessEventKind.STOPPING, message=reason)
        self._stopping.set()
        return True

    def _way_to_ask(self) -> Callable[[], bool] | None:
        return self._ask_to_stop if self._can_be_asked else None

    def _ask_to_stop(self) -> bool:
        if self._link is None:
            return False
        try:
            self._link.send(Shutdown(reason=self._stop_reason))
        except ControlError:
            return False
        return True

    async def _gone(self) -> None:
        """Wait until nothing of the ended process is left."""
        process, self._process = self._process, None
        if process is not None:
            await self._reports.gone(process)

    def _started(self, process: ManagedProcess) -> None:
        self._ready_at = None
        self._ended = False
        self._killed_because = ""
        self._mechanism = ""
        self._blames_loads = True
        # One that somebody else starts comes when it comes.
        attaches = self._config.attach
        self._hello_due = None if attaches else self._loop.time() + self._limits.hello
        self._reports.started(process)

    def _greeted(self, link: ControlLink, hello: Hello) -> None:
        self._hello_due = None
        self._mechanism = hello.mechanism
        actions = self._apply(ContainerInput.HELLO)
        if ContainerAction.LOAD_NODES not in actions:
            return
        self._ready_at = self._loop.time()
        if hello.full_node_name != self._name:
            _log.warning("%s calls itself %s", self._name, hello.full_node_name)
        self._reports.publish(ProcessEventKind.READY, message=description(hello))
        lack = what_is_lacking(self._config, hello)
        if lack and self._publisher.is_news(lack):
            _log.warning("%s: %s", self._name, lack)
        self._watch.begin(link.send)
        self._nodes.container_ready(link.send)
        self._deadlines_changed.set()

    def _lived(self) -> float | None:
        """Give the seconds since the hello; None: it did not come to that."""
        return None if self._ready_at is None else self._loop.time() - self._ready_at

    def _immortal(self, process: ManagedProcess) -> Death:
        reason = "does not die, not even of SIGKILL"
        _log.error("%s (pid %d) %s", self._name, process.pid, reason)
        self._process = None
        return Death(reason, permanent=True)

    def _die(self, death: Death) -> tuple[ContainerAction, ...]:
        """Decide what follows from the end of the process."""
        self._death_reason = death.reason
        if self._state in {ContainerState.STOPPING, ContainerState.GAVE_UP}:
            return self._apply(ContainerInput.DIED_FOR_GOOD, death.reason)
        if death.permanent:
            return self._apply(ContainerInput.DIED_FOR_GOOD, death.reason)
        if death.by_itself:
            _told.warning("%s: stopped, and is not started again: %s", self._name, death.reason)
            return self._apply(ContainerInput.ENDED_ITSELF, death.reason)
        counts = not (self._blames_loads and self._nodes.suspects.excuse_death())
        verdict = self._restarter.decide(now=self._loop.time(), lived=death.lived, counts=counts)
        if isinstance(verdict, GiveUp):
            reason = f"{death.reason}; {verdict.reason}"
            return self._apply(ContainerInput.DIED_FOR_GOOD, reason)
        self._delay = verdict.delay
        self._reports.restarts = self._restarter.total
        sequel = "looked for again" if self._config.attach else "starts again"
        reason = f"{death.reason}; {sequel} in {verdict.delay:.2f} s"
        actions = self._apply(ContainerInput.DIED_RESTART, reason)
        _told.warning("%s: %s", self._name, reason)
        self._reports.publish(ProcessEventKind.RESTARTING, message=reason)
        return actions

    def _apply(self, said: ContainerInput, reason: str = "") -> tuple[ContainerAction, ...]:
        state, actions = TABLE[self._state][said]
        if state is not self._state:
            self._state = state
            self._publish_state(reason)
        for action in actions:
            match action:
                case ContainerAction.LOSE_NODES:
                    self._nodes.container_lost(f"its container: {reason}")
                    if said is ContainerInput.DIED_RESTART:
                        blame = self._death_reason if self._blames_loads else ""
                        self._nodes.container_comes_back(blame)
                case ContainerAction.KILL:
                    _log.error("%s is killed: %s", self._name, reason)
                    self._kill(reason)
                case ContainerAction.REPORT_GAVE_UP:
                    _told.error("%s is not started again: %s", self._name, reason)
                    self._reports.publish(ProcessEventKind.GAVE_UP, message=reason)
                case _:
                    pass  # the caller's part
        return actions

    def _kill(self, reason: str) -> None:
        assert self._process is not None
        self._killed_because = reason
        self._reports.publish(ProcessEventKind.STOPPING, message=f"killed: {reason}")
        self._process.kill()

    def _publish_state(self, reason: str) -> None:
        mechanism = self._mechanism if self._state is ContainerState.RUNNING else ""
        self._publisher.publish_container(self._name, self._state, reason, mechanism)
