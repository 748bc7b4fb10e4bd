"""What follows later: events, timers, exits and states, each of which happens once here.

Handlers that name actions get real events and decide themselves. What they yield is visited under
the condition that the event has happened. Everything else is reported, and never called.
"""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Iterable
from functools import partial
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from launch.event_handlers import OnProcessExit, OnProcessStart
from launch.events import IncludeLaunchDescription, Shutdown
from launch.events.process import ProcessExited, ProcessStarted, ShutdownProcess, SignalProcess
from launch_ros.actions import LifecycleTransition
from launch_ros.event_handlers import OnStateTransition
from launch_ros.events.lifecycle import ChangeState, StateTransition

from play_launch.config.model import Autostart
from play_launch.launch_files.records import Event, LaunchedProcess, StartCondition

if TYPE_CHECKING:
    from collections.abc import Callable

    from play_launch.launch_files.records import Place
    from play_launch.launch_files.ros_launch.scene import Conditions, Scene

_MOST: Final = 10_000
"""Events that are followed; transitions that lead to one another have no end."""
_OF_A_PROCESS: Final = 4
"""Steps that each process of the description takes: it starts, it exits, and an event of both."""
_TARGET: Final = "_OnStateTransition__target_lifecycle_node"


class _Step(NamedTuple):
    label: str
    start: str
    between: str
    goal: str


# The numbers of lifecycle_msgs/msg/Transition, as the state machine of rcl_lifecycle has them.
_STEPS: Final = {
    1: _Step("configure", "unconfigured", "configuring", "inactive"),
    2: _Step("cleanup", "inactive", "cleaningup", "unconfigured"),
    3: _Step("activate", "inactive", "activating", "active"),
    4: _Step("deactivate", "active", "deactivating", "inactive"),
    5: _Step("shutdown", "unconfigured", "shuttingdown", "finalized"),
    6: _Step("shutdown", "inactive", "shuttingdown", "finalized"),
    7: _Step("shutdown", "active", "shuttingdown", "finalized"),
}
_AUTOSTART: Final = {"configure": Autostart.CONFIGURE, "activate": Autostart.ACTIVATE}


class _Registered(NamedTuple):
    conditions: Conditions
    includes: tuple[Place, ...]
    part: Any


class _Emitted(NamedTuple):
    event: Any
    conditions: Conditions
    part: Any = None


class EventSimulation:
    """The events that are still to come; `visit` visits an entity of the description."""

    def __init__(self, scene: Scene, visit: Callable[[Any], None]) -> None:
        self._scene = scene
        self._visit = visit
        self._events: deque[_Emitted] = deque()
        self._registered: dict[int, _Registered] = {}
        self._heard: set[int] = set()
        self._processes: list[tuple[Any, LaunchedProcess]] = []
        self._states: dict[str, str] = {}
        self._timers: list[tuple[float, int, Any, _Registered]] = []
        self._count_of_timers = 0
        self.current_part: Any = None
        """What is visited now, the part of the description that has the place."""

    # What the replaced ends of launch report

    def post(self, event: Any) -> None:
        """An event was emitted by what is visited now."""
        self._events.append(_Emitted(event, self._scene.causes.now, self.current_part))

    def registers(self, handler: Any) -> bool:
        """Return whether a handler of what is visited now is followed; others are reported."""
        what = f"{type(handler).__name__}: what it does is not carried over"
        if isinstance(handler, OnProcessStart | OnProcessExit | OnStateTransition):
            what = "a function decides what follows; it is not called"
            if _names_actions(handler):
                part = self.current_part
                self._registered[id(handler)] = self._here(self._scene.causes.now, part)
                return True
        # launch_ros has one of its own, for transitions that fail.
        if not isinstance(self.current_part, LifecycleTransition):
            self._scene.lost(self.current_part, what)
        return False

    def executed(self, action: Any, process: LaunchedProcess) -> None:
        """A process would be started; a managed node is unconfigured once it runs."""
        self._processes.append((action, process))
        if process.is_lifecycle:
            self._states[process.id] = "unconfigured"

    def timed(self, action: Any, seconds: float) -> None:
        """A timer was started."""
        delay = StartCondition(event=Event.DELAY, seconds=seconds)
        known = self._here((*self._scene.causes.now, delay), action)
        # In the order in which they fire: what one of them sets is known to those after it.
        due = sum(each.seconds for each in known.conditions)
        heapq.heappush(self._timers, (due, self._count_of_timers, action, known))
        self._count_of_timers += 1

    def _here(self, conditions: Conditions, part: Any) -> _Registered:
        return _Registered(conditions, tuple(self._scene.places.includes), part)

    # What happens

    def run(self) -> None:
        """Let everything happen that can, until nothing is left."""
        started = exited = count = 0
        while count < _MOST + _OF_A_PROCESS * len(self._processes):
            count += 1
            if self._events:
                self._handle(self._events.popleft())
            elif started < len(self._processes):
                action, process = self._processes[started]
                happened = StartCondition(event=Event.STARTED, unit=process.id)
                self._post(ProcessStarted(**action.process_details, pid=0), happened)
                started += 1
            elif self._timers:
                _, _, action, known = heapq.heappop(self._timers)
                if not getattr(action, "_TimerAction__canceled", False):
                    with self._scene.causes.under(known.conditions):
                        self._carry_out(partial(action.handle, self._scene.context), known)
            elif exited < len(self._processes):
                action, process = self._processes[exited]
                happened = StartCondition(event=Event.EXITED, unit=process.id)
                event = ProcessExited(**action.process_details, pid=0, returncode=0)
                self._post(event, happened)
                exited += 1
            else:
                self._report_unheard()
                return
        self._scene.lost(None, f"events that follow the first {count}")

    def _post(self, event: Any, condition: StartCondition) -> None:
        self._events.append(_Emitted(event, (condition,)))

    def _handle(self, emitted: _Emitted) -> None:
        event, conditions, part = emitted
        if isinstance(event, ChangeState):
            self._change_state(event, conditions, part)
        elif isinstance(event, Shutdown):
            # Its handlers are reported: there is nothing to be started then.
            self._shut_down(event, conditions, part)
        elif isinstance(event, ShutdownProcess | SignalProcess):
            when = f" when {self._scene.described(conditions)}" if conditions else ""
            self._scene.lost(part, f"{event.name}: a process is ended by the launch file{when}")
        elif isinstance(event, IncludeLaunchDescription):
            self._scene.lost(part, "an emitted IncludeLaunchDescription")
        for handler in tuple(self._scene.context._event_handlers):  # noqa: SLF001 - its only list
            if handler.matches(event):
                self._heard.add(id(handler))
                known = self._registered[id(handler)]
                together = self._scene.causes.followed_by(known.conditions, conditions)
                with self._scene.causes.under(together):
                    handle = partial(handler.handle, event, self._scene.context)
                    self._carry_out(handle, known)

    def _carry_out(self, yields: Callable[[], Any], known: _Registered) -> None:
        """Visit what a handler or a timer yields, where it was registered."""
        scene = self._scene
        before, scene.places.includes = scene.places.includes, list(known.includes)
        scene.places.visited = scene.places.of_part(known.part)
        scene.context._push_locals()  # noqa: SLF001 - as LaunchService does
        try:
            entities = yields()
            for entity in entities if isinstance(entities, Iterable) else (entities,):
                if entity is not None:
                    self._visit(entity)
        except BaseException as error:
            scene.places.annotate(error, scene.places.of_part(known.part))
            raise
        finally:
            scene.context._pop_locals()  # noqa: SLF001
            scene.places.includes = before

    def _shut_down(self, event: Any, conditions: Conditions, part: Any) -> None:
        if len(conditions) == 1 and conditions[0].event is Event.EXITED:
            unit = self._scene.unit(conditions[0].unit)
            if isinstance(unit, LaunchedProcess):
                unit.ends_all = True
                return
        when = self._scene.described(conditions) if conditions else "it was evaluated"
        self._scene.lost(part, f"the launch file shuts everything down when {when}: {event.reason}")

    def _report_unheard(self) -> None:
        """Report handlers of states that managed nodes of the launch file do not reach by it."""
        actions = [action for action, _ in self._processes]
        for handler in self._scene.context._event_handlers:  # noqa: SLF001 - its only list
            part = self._registered[id(handler)].part
            target = getattr(handler, _TARGET, None)
            if (
                isinstance(handler, OnStateTransition)
                and id(handler) not in self._heard
                and self._scene.places.of_part(part).file
                and (target is None or any(each is target for each in actions))
            ):
                what = "OnStateTransition: what it handles does not follow from the launch file"
                self._scene.lost(part, what)

    # Managed nodes

    def _change_state(self, event: Any, conditions: Conditions, part: Any) -> None:
        """Carry out a transition of the nodes that an event is for."""
        name = ChangeState.valid_transitions[event.transition_id]
        step = _STEPS.get(event.transition_id)
        found = [
            pair
            for pair in self._processes
            if pair[1].is_lifecycle and event.lifecycle_node_matcher(pair[0])
        ]
        if not found:
            self._scene.lost(part, f"{name} for a node that is no LifecycleNode of the launch file")
        for action, process in found:
            state = self._states[process.id]
            if step is None or step.start != state:
                what = f"the transition {step.label if step else name}"
                self._scene.lost(process, f"{what}, which is not possible when {state}")
                continue
            self._note_transition(process, step, conditions)
            self._states[process.id] = step.goal
            self._report_state(action, process, step.label, step.start, step.between)
            self._report_state(action, process, "transition_success", step.between, step.goal)

    def _report_state(
        self, action: Any, process: LaunchedProcess, label: str, *states: str
    ) -> None:
        from lifecycle_msgs.msg import TransitionEvent  # noqa: PLC0415 - for managed nodes only

        message = TransitionEvent()
        message.transition.label = label
        message.start_state.label, message.goal_state.label = states
        condition = StartCondition(event=Event.STATE, unit=process.id, state=states[1])
        self._post(StateTransition(action=action, msg=message), condition)

    def _note_transition(
        self, process: LaunchedProcess, step: _Step, conditions: Conditions
    ) -> None:
        """Note how far the node is brought; report where that has further conditions."""
        if step.label not in _AUTOSTART:
            when = self._scene.described(conditions)
            self._scene.lost(process, f"the transition {step.label} when {when}")
            return
        process.autostart = _AUTOSTART[step.label]
        own = self._scene.causes.of_unit(process.id)
        foreign = tuple(each for each in conditions if each.unit != process.id and each not in own)
        if foreign:
            when = self._scene.described(foreign)
            self._scene.lost(process, f"{step.label} only when {when}; it is done at once")


def _names_actions(handler: Any) -> bool:
    """Return whether a handler names the actions that follow, instead of deciding by a function."""
    has_function = callable(getattr(handler, "_OnActionEventBase__on_event", None))
    package = type(handler).handle.__module__.partition(".")[0]
    return not has_function and package in {"launch", "launch_ros"}
