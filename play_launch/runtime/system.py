"""A running system: one world, the inputs that change it, and the effects that follow."""

from __future__ import annotations

import asyncio
import logging
import math
import os
import random
from collections import deque
from functools import partial
from typing import TYPE_CHECKING, Final

import anyio

from play_launch.container.messages import Cancel, Unload
from play_launch.recording.log_handler import REPORTED_LOGGER
from play_launch.runtime.container_actor import ContainerActor
from play_launch.runtime.outside import Conversation, Outside
from play_launch.runtime.process_actor import ProcessActor, Tasks
from play_launch.runtime.publisher import EventLog
from play_launch.supervisor import inputs
from play_launch.supervisor.conditions import awaited_dependencies, has_ended, pending_units
from play_launch.supervisor.difference import events_since
from play_launch.supervisor.events import ManagedState
from play_launch.supervisor.plan import StepOutcome
from play_launch.supervisor.reducer import deadline, reduce
from play_launch.supervisor.world import STATE_OF_PHASE, Limits, Phase, World, is_wanted

if TYPE_CHECKING:
    from collections.abc import Callable

    from play_launch.config.model import ReplayConfig
    from play_launch.config.node_key import NodeKey
    from play_launch.recording.decisions import DecisionLog
    from play_launch.ros.access import RosAccess
    from play_launch.ros.parameters import ParameterSetter
    from play_launch.runtime.applying import Applying
    from play_launch.runtime.launcher import NativeLauncher
    from play_launch.runtime.publisher import Publisher
    from play_launch.runtime.signals import StopRequests
    from play_launch.supervisor.events import ContainerState
    from play_launch.supervisor.inputs import Effect, Input
    from play_launch.supervisor.view import SystemView

_log = logging.getLogger(__name__)
_reported = logging.getLogger(REPORTED_LOGGER)

_RETRY_INTERVAL: Final = 1.0
"""Seconds after which what is due, and was not settled, is evaluated again."""
LATE: Final = 5.0
"""Seconds after which what is due counts as forgotten."""


class System:
    """A world and what acts on it. Belongs to the thread of the event loop."""

    def __init__(
        self,
        config: ReplayConfig,
        publisher: Publisher,
        stop: StopRequests,
        *,
        launcher: NativeLauncher,
        parameters: ParameterSetter | None = None,
        limits: Limits | None = None,
        starts: int = 16,
        ros: RosAccess | None = None,
        decisions: DecisionLog | None = None,
    ) -> None:
        """Begin nothing yet; ``starts`` bounds how many containers start at the same time."""
        self.world = World(config, starts=starts, limits=limits)
        self.config = config
        self.publisher = publisher
        self.launcher = launcher
        self.stop_requests = stop
        self._decisions = decisions
        self._parameters = parameters
        self._loop = asyncio.get_running_loop()
        self._inputs: deque[Input] = deque()
        self._is_busy = False
        self._is_closed = False
        self._timer: asyncio.TimerHandle | None = None
        self._is_overdue = False
        """Whether what is due was evaluated and stays due."""
        self._changed = asyncio.Event()
        self._actors: dict[str, ProcessActor] = {}
        self._ros = ros
        self.tasks = Tasks(self.fail)
        self.outside = Outside(self)
        self._conversations: dict[str, Conversation] = {}
        self._applying: Applying | None = None
        self._at_end: tuple[SystemView, tuple[str, ...]] | None = None
        """The view and `pending` when the first stop was requested."""
        self.probe_slots = anyio.Semaphore(max(2, os.cpu_count() or 1))
        """For scratch processes: loading a library is CPU time and reading."""
        publisher.add_sink(self.outside)
        publisher.add_sink(EventLog())
        self.outside.expect(config.start_rules.values())

    # Inputs and effects.

    def post(self, said: Input) -> None:
        """Process an input at once, or after the one that is being processed."""
        self._inputs.append(said)
        if self._is_busy:
            return
        self._is_busy = True
        try:
            while self._inputs or self._is_due():
                said = self._inputs.popleft() if self._inputs else inputs.Time()
                now = self._loop.time()
                jitter = random.getrandbits(16) / (1 << 16)  # 16 bits: each is recorded
                if self._decisions is not None:
                    self._decisions.add(now, said, jitter)
                effects = reduce(self.world, said, now, jitter)
                self._is_overdue = isinstance(said, inputs.Time) and not any(self.world.before)
                self._publish(now, type(said).__name__)
                for effect in effects:
                    self._carry_out(effect)
        finally:
            self._is_busy = False
        self._settled()

    def _is_due(self) -> bool:
        due = deadline(self.world)
        is_open = not self._is_overdue and not self._is_closed
        return due is not None and due <= self._loop.time() and is_open

    def _publish(self, now: float, cause: str) -> None:
        """Publish what has changed."""
        try:
            stamp_ns = self.publisher.stamp_ns()
            for event in events_since(self.world, now=now, stamp_ns=stamp_ns):
                self.publisher.publish(event)
        except Exception:  # noqa: BLE001 - what was decided is carried out all the same
            _log.exception("what changed with %s could not be published", cause)

    def fail(self, unit: str, error: Exception) -> None:
        """Give a unit up because of an exception of our own; the others go on."""
        reason = _failure_reason(error)
        text = f"{unit or 'supervisor'}: {reason}"
        process = self.world.processes.get(unit)
        # A rule may raise whenever it is evaluated: its unit is given up once.
        is_given_up = process is None or process.phase is Phase.GAVE_UP
        if self.publisher.is_news(text) or not is_given_up:
            _reported.error("%s", text, exc_info=error)
        if not is_given_up:
            self.post(inputs.Failed(unit, reason))

    def _settled(self) -> None:
        try:
            self.outside.watch(awaited_dependencies(self.world))
        except Exception:  # noqa: BLE001 - what waits has time limits, and can be started
            _log.exception("what starts depend on cannot be watched")
        for name in [name for name in self._actors if name not in self.world.processes]:
            del self._actors[name]
        self._changed.set()
        self._changed = asyncio.Event()
        self._set_timer()

    def _set_timer(self) -> None:
        due = deadline(self.world)
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        if due is not None and not self._is_closed:
            if self._is_overdue:
                due = max(due, self._loop.time() + _RETRY_INTERVAL)
            self._timer = self._loop.call_at(due, self._on_time)

    def _on_time(self) -> None:
        self._timer = None
        self._is_overdue = False
        if self._is_due():
            self.post(inputs.Time())
        else:  # the clock of the loop is coarse: a timer may fire early
            self._set_timer()

    def _carry_out(self, effect: Effect) -> None:
        try:
            match effect:
                case inputs.Spawn():
                    self._actor(effect.unit).spawn(effect.start)
                case inputs.Kill():
                    self._actor(effect.unit).kill(effect.start)
                case inputs.Stop():
                    actor = self._actor(effect.unit)
                    actor.stop(effect.start, asks=effect.asks, reason=effect.reason)
                case inputs.Load():
                    self._container(effect.node.container).load(effect.node, effect.attempt)
                case inputs.Unload():
                    request = Cancel if effect.is_loading else Unload
                    self._container(effect.container).send(request(unique_id=effect.unique_id))
                case inputs.Query():
                    self._container(effect.container).query(effect.about)
                case inputs.Probe():
                    self._container(effect.container).probe(effect.nodes)
                case inputs.Drive():
                    self._drive(effect)
                case inputs.SetParameters():
                    self.tasks.begin(partial(self.applying.set_parameters, effect.step))
                case StepOutcome():
                    self.applying.step_ended(effect)
                case inputs.Log():
                    logger = _reported if effect.is_shown_otherwise else _log
                    logger.log(
                        logging.ERROR if effect.is_error else logging.WARNING, "%s", effect.text
                    )
                case inputs.Raised():
                    self.fail(effect.unit, effect.error)
                case inputs.End():
                    self.stop_requests.request(reason=effect.reason)
                    self.post(inputs.StopRequested(effect.reason))
        except Exception as error:  # noqa: BLE001 - it is the failure of its unit alone
            self.fail(getattr(effect, "unit", getattr(effect, "container", "")), error)

    def _drive(self, effect: inputs.Drive) -> None:
        """Begin a conversation with a node, request a transition, or end the conversation."""
        talk = self._conversations.get(effect.unit)
        if effect.to in {ManagedState.CONFIGURING, ManagedState.ACTIVATING}:
            if talk is not None and talk.instance == effect.instance:
                talk.transit(effect.to)
            return
        if talk is not None:
            talk.end()
            del self._conversations[effect.unit]
        if effect.to is ManagedState.ASKED:
            self._conversations[effect.unit] = Conversation(self, effect.unit, effect.instance)

    def _actor(self, name: str) -> ProcessActor:
        kind = ProcessActor if self.world.processes[name].container is None else ContainerActor
        if type(self._actors.get(name)) is not kind:  # its name may have been one of the other kind
            self._actors[name] = kind(name, self)
        return self._actors[name]

    def _container(self, name: str) -> ContainerActor:
        actor = self._actor(name)
        assert isinstance(actor, ContainerActor)
        return actor

    @property
    def ros(self) -> RosAccess:
        """Access to the graph and to managed nodes."""
        if self._ros is None:
            # Imported only where it is needed: rclpy takes long.
            from play_launch.ros.access import RosAccess  # noqa: PLC0415

            self._ros = RosAccess(self.config.environment)
        return self._ros

    # Queries and requests.

    @property
    def processes(self) -> tuple[str, ...]:
        """Full names of the ordinary executables, as declared."""
        return tuple(name for name, each in self.world.processes.items() if each.container is None)

    @property
    def applying(self) -> Applying:
        """What changes it while it runs."""
        if self._applying is None:
            # The start of a system needs none of it.
            from play_launch.ros.parameters import ParameterSetter  # noqa: PLC0415
            from play_launch.runtime.applying import Applying  # noqa: PLC0415

            self._applying = Applying(self, self._parameters or ParameterSetter())
        return self._applying

    async def until_applied(self) -> None:
        if self._applying is not None:
            await self._applying.idle.wait()

    @property
    def is_stopping(self) -> bool:
        return self.stop_requests.requested.is_set()

    @property
    def is_changing(self) -> bool:
        return self._applying is not None and not self._applying.idle.is_set()

    @property
    def pending(self) -> tuple[str, ...]:
        """Units that have neither been up nor failed for good, as it was when its end began."""
        return pending_units(self.world) if self._at_end is None else self._at_end[1]

    @property
    def view_before_stop(self) -> SystemView:
        """The view as it was when its end began, or is as long as that did not."""
        return self.publisher.view if self._at_end is None else self._at_end[0]

    def _note_end(self) -> None:
        self._at_end = self.publisher.view, pending_units(self.world)

    def health_problem(self) -> str:
        """Describe a health problem of the supervisor; else empty."""
        due = deadline(self.world)
        late = 0.0 if due is None or self._is_closed else self._loop.time() - due
        return f"what was due {late:.0f} s ago is not done" if late > LATE else ""

    def state_of(self, member: str) -> ContainerState:
        """State of a container or executable; KeyError for an unknown name."""
        return STATE_OF_PHASE[self.world.processes[member].phase]

    async def until_at_rest(self, member: str) -> ContainerState | None:
        """Wait until one is at rest and return its state; None when it is wanted again before."""
        process = self.world.processes[member]
        while not process.is_at_rest:
            if is_wanted(self.world, process) and process.phase is not Phase.GAVE_UP:
                return None
            await self._changed.wait()
            process = self.world.processes.get(member, process)
            if member not in self.world.processes:
                break
        return STATE_OF_PHASE[process.phase]

    def start(self, unit: str | NodeKey) -> None:
        """Have a process run, or a node loaded, that is not, whatever it depends on.

        KeyError for an unknown unit, here and below.
        """
        self.post(inputs.StartRequested(self._known(unit)))

    def stop(self, unit: str | NodeKey, reason: str = "") -> None:
        """Have one stopped, or unloaded, for good; the others are left alone."""
        self.post(inputs.EndRequested(self._known(unit), reason))

    def restart(self, unit: str | NodeKey, reason: str = "") -> None:
        """Have one replaced by a new one, or started."""
        self.post(inputs.StartRequested(self._known(unit), anew=True, reason=reason))

    def _known(self, unit: str | NodeKey) -> str:
        units = self.world.processes if isinstance(unit, str) else self.world.nodes
        if unit not in units:
            raise KeyError(unit)
        return str(unit)

    # From start to end.

    async def run(self) -> None:
        """Run it to its end, see `play_launch.runtime.run`."""
        until = None if self.config.duration is None else self._loop.time() + self.config.duration
        self._publish(self._loop.time(), "the configuration")
        self.stop_requests.on_request = self._note_end
        if self.stop_requests.requested.is_set():
            self._note_end()
        try:
            async with anyio.create_task_group() as tasks:
                self.tasks.run_in(tasks)
                if not self.stop_requests.requested.is_set():
                    self.post(inputs.Time())
                with anyio.CancelScope(deadline=math.inf if until is None else until):
                    await self.stop_requests.requested.wait()
                if not self.stop_requests.requested.is_set():
                    reason = f"its duration of {self.config.duration:g} s is over"
                    self.stop_requests.request(reason=reason)
                _log.info("stopping: %s", self.stop_requests.reason)
                tasks.start_soon(self._hurry)
                self.post(inputs.StopRequested(self.stop_requests.reason))
                await self.until(lambda: has_ended(self.world))
                tasks.cancel_scope.cancel()
        finally:
            self._close()
            await self.outside.close()
            if self._applying is not None:
                await self._applying.close()

    async def _hurry(self) -> None:
        await self.stop_requests.hurry.wait()
        self.post(inputs.StopRequested(is_hurried=True))

    def _close(self) -> None:
        self._is_closed = True
        if self._timer is not None:
            self._timer.cancel()

    async def until(self, condition: Callable[[], bool]) -> None:
        """Wait until a condition of the world holds."""
        while not condition():
            await self._changed.wait()


def _failure_reason(error: Exception) -> str:
    """Name an unexpected exception in one line; of a group, the first one."""
    while isinstance(error, ExceptionGroup):
        error = error.exceptions[0]
    text = " ".join(f"{type(error).__name__}: {error}".split())
    return f"internal error (its call stack is in the recording): {text}"
