"""What follows later: events, timers, exits and states, each of which happens once here.

The handlers of the launch file get real events and decide themselves. What they yield is visited
under the condition that the event has happened.
"""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Iterable
from functools import partial
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from launch.event_handlers import OnProcessIO, OnShutdown
from launch.events import Shutdown, TimerEvent
from launch.events.process import ProcessExited, ProcessStarted, ShutdownProcess, SignalProcess
from launch_ros.events.lifecycle import ChangeState

from play_launch.launch_files.records import AtExit, Event, Process, StartCondition
from play_launch.launch_files.ros_launch.causes import follow_an_exit
from play_launch.launch_files.ros_launch.lifecycle import Lifecycles
from play_launch.launch_files.ros_launch.unheard import Unheard, decides_by_status

if TYPE_CHECKING:
    from collections.abc import Callable

    from play_launch.launch_files.records import Place
    from play_launch.launch_files.ros_launch.causes import Conditions
    from play_launch.launch_files.ros_launch.scene import Scene

_MOST: Final = 20_000
"""How many events are followed; a handler that starts what it handles has no end."""
_OF_A_PROCESS: Final = 4
"""Steps that each process of the description takes: it starts, it exits, and an event of both."""
_MOST_IN_TURN: Final = 100
"""How many events are followed where each comes of the one before."""
_TOO_MANY_IN_TURN: Final = f"what follows {_MOST_IN_TURN} events, one after the other"


def _has_function(handler: Any) -> bool:
    """Whether a handler calls what the launch file defines, instead of naming actions."""
    if callable(getattr(handler, "_OnActionEventBase__on_event", None)):
        return True
    return type(handler).handle.__module__.partition(".")[0] not in {"launch", "launch_ros"}


class Completion:
    """Future of an action: callbacks for its end."""

    def __init__(self) -> None:
        self.callbacks: list[Callable[[Any], None]] = []

    def add_done_callback(self, callback: Callable[[Any], None]) -> None:
        """As a future has it."""
        self.callbacks.append(callback)

    def done(self) -> bool:
        """As a future has it."""
        return False

    def __call__(self) -> None:
        """Call the callbacks."""
        for callback in self.callbacks:
            callback(None)


class _Registered(NamedTuple):
    conditions: Conditions
    includes: tuple[Place, ...]
    part: Any


class _Emitted(NamedTuple):
    event: Any
    conditions: Conditions
    part: Any = None


class _Timer(NamedTuple):
    action: Any
    conditions: Conditions
    includes: tuple[Place, ...]


class Happenings:
    """The events that are still to come; `visit` visits an entity of the description."""

    def __init__(self, scene: Scene, visit: Callable[[Any], None]) -> None:
        self._scene = scene
        self._visit = visit
        self._events: deque[_Emitted] = deque()
        self._handling: frozenset[int] = frozenset()
        self._makers: dict[int, frozenset[int]] = {}
        self._registered: dict[int, _Registered] = {}
        self._processes: list[tuple[Any, Process]] = []
        self._timers: list[tuple[float, int, _Timer]] = []
        self._unheard = Unheard(scene)
        self._completions: dict[int, Completion] = {}
        self._lifecycles = Lifecycles(scene, self._post)
        self._count = self._count_of_timers = 0
        self.current_part: Any = None
        """What is visited now, the part of the description that has the place."""

    # What the ends report

    def post(self, event: Any) -> None:
        """An event was emitted by what is visited now."""
        self._events.append(_Emitted(event, self._scene.causes.now, self.current_part))

    def _post(self, event: Any, conditions: Conditions) -> None:
        self._events.append(_Emitted(event, conditions))

    def registered(self, handler: Any) -> None:
        """A handler was registered by what is visited now."""
        includes = tuple(self._scene.places.includes)
        part = self.current_part
        self._unheard.add(handler, part)
        self._registered[id(handler)] = _Registered(self._scene.causes.now, includes, part)
        if isinstance(handler, OnShutdown):
            self._scene.lost(part, "OnShutdown: its actions are not carried out")
        elif isinstance(handler, OnProcessIO):
            self._scene.lost(part, "OnProcessIO: what follows the output of a process")

    def executed(self, action: Any, process: Process) -> None:
        """A process would be started."""
        self._processes.append((action, process))
        self._makers[id(action)] = self._handling
        if process.is_lifecycle:
            self._lifecycles.add(action, process)

    def timed(self, action: Any, seconds: float) -> None:
        """A timer was started."""
        delay = StartCondition(event=Event.DELAY, seconds=seconds)
        conditions = (*self._scene.causes.now, delay)
        timer = _Timer(action, conditions, tuple(self._scene.places.includes))
        # In the order in which they fire: what one of them sets is known to those after it.
        due = sum(each.seconds for each in conditions)
        heapq.heappush(self._timers, (due, self._count_of_timers, timer))
        self._count_of_timers += 1

    def completion(self, action: Any) -> Completion:
        """Return what stands for the future of an action."""
        return self._completions.setdefault(id(action), Completion())

    # What happens

    def run(self) -> None:
        """Let everything happen that can, until nothing is left."""
        started = exited = 0
        most = _MOST + _OF_A_PROCESS * len(self._processes)
        while True:
            if self._events:
                self._handle(self._events.popleft())
            elif started < len(self._processes):
                self._start(*self._processes[started])
                started += 1
            elif self._timers:
                self._fire(heapq.heappop(self._timers)[-1])
            elif exited < len(self._processes):
                self._exit(*self._processes[exited])
                exited += 1
            else:
                self._unheard.report([action for action, _ in self._processes])
                return
            self._count += 1
            if self._count > most:
                self._scene.lost(None, f"events that follow the first {most}")
                return

    def _start(self, action: Any, process: Process) -> None:
        event = ProcessStarted(**action.process_details, pid=0)
        self._post(event, (StartCondition(event=Event.STARTED, unit=process.id),))

    def _exit(self, action: Any, process: Process) -> None:
        conditions = (StartCondition(event=Event.EXITED, unit=process.id),)
        self._post(ProcessExited(**action.process_details, pid=0, returncode=0), conditions)
        with self._scene.causes.under(conditions):
            self.completion(action)()

    def _fire(self, timer: _Timer) -> None:
        if getattr(timer.action, "_TimerAction__canceled", False):
            return
        with self._scene.causes.under(timer.conditions):
            known = _Registered(timer.conditions, timer.includes, timer.action)
            self._carry_out(partial(timer.action.handle, self._scene.context), known)
            self.post(TimerEvent(timer_action=timer.action))
            self.completion(timer.action)()

    def _handle(self, emitted: _Emitted) -> None:
        event, conditions, part = emitted
        if isinstance(event, ChangeState):
            self._lifecycles.change(event, conditions, part)
        elif isinstance(event, Shutdown):
            # Its handlers are reported: there is nothing to be started then.
            self._shut_down(event, conditions, part)
            return
        elif isinstance(event, ShutdownProcess | SignalProcess):
            when = f" when {self._scene.described(conditions)}" if conditions else ""
            self._scene.lost(part, f"{event.name}: a process is ended by the launch file{when}")
        for handler in tuple(self._scene.context._event_handlers):  # noqa: SLF001 - its only list
            if isinstance(handler, OnProcessIO | OnShutdown) or not handler.matches(event):
                continue
            self._unheard.heard(handler)
            known = self._registered.get(id(handler), _Registered((), (), None))
            makers = self._makers.get(id(getattr(event, "action", None)), frozenset())
            if id(handler) in makers:
                self._scene.lost(
                    known.part, "it follows its own processes, and there is no end of it"
                )
                continue
            if len(makers) >= _MOST_IN_TURN:
                self._scene.lost(known.part, _TOO_MANY_IN_TURN)
                continue
            together = self._scene.causes.followed_by(known.conditions, conditions)
            if follow_an_exit(together) and _has_function(handler):
                when = self._scene.described(together)
                what = f"a function decides what follows when {when}; it is not called"
                self._scene.lost(known.part, what)
                continue
            before, self._handling = self._handling, makers | {id(handler)}
            with self._scene.causes.under(together):
                if decides_by_status(handler, event):
                    what = "it asks for exit status 0; what follows does so at any status"
                    self._scene.lost(known.part, what)
                self._carry_out(partial(handler.handle, event, self._scene.context), known)
            self._handling = before

    def _carry_out(self, yields: Callable[[], Any], known: _Registered) -> None:
        """Visit what a handler or a timer yields, where it was registered."""
        scene = self._scene
        if len(scene.causes.now) > _MOST_IN_TURN:
            scene.lost(known.part, _TOO_MANY_IN_TURN)
            return
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
            if isinstance(unit, Process):
                unit.on_exit = AtExit.SHUTDOWN
                return
        when = self._scene.described(conditions) if conditions else "it was evaluated"
        self._scene.lost(part, f"the launch file shuts everything down when {when}: {event.reason}")
