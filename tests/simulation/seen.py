"""What was wanted and what happened, noted from inputs, effects and events; no rule is asked."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final, NamedTuple

from play_launch.config.node_key import NodeKey
from play_launch.supervisor import inputs as said
from play_launch.supervisor.events import ContainerState as State
from play_launch.supervisor.events import (
    ContainerStateChanged,
    NodeState,
    NodeStateChanged,
    ProcessEvent,
    ProcessEventKind,
    Withdrawn,
)
from play_launch.supervisor.plan import PlanAction, Result, StepOutcome

from .person import unit_of

if TYPE_CHECKING:
    from play_launch.supervisor.events import RunEvent
    from play_launch.supervisor.world import Exit, Goal, Node, Process

    from .machine import Machine

LOADING: Final = frozenset({NodeState.REQUESTED, NodeState.LOADING})


class Snapshot(NamedTuple):
    """The units of a world at one moment."""

    processes: dict[str, Process]
    nodes: dict[NodeKey, Node]
    goals: dict[str, Goal]


class BrokenError(AssertionError):
    """An invariant does not hold."""

    def __init__(self, name: str, text: str, units: tuple[str, ...] = ()) -> None:
        super().__init__(f"[{name}] {text}")
        self.name = name
        self.units = {unit_of(each) for each in units}
        """What it is about; empty: everything."""


@dataclass
class Ending:
    """How a start ended: a process exited, or none came."""

    at: float
    exit: Exit | None
    lived: float
    was_ready: bool
    is_permanent: bool
    was_stopped: bool
    """Whether the supervisor had stopped it."""
    was_killed: bool
    under_way: frozenset[NodeKey]
    """Nodes that were being loaded into it."""


@dataclass
class Starts:
    """The starts of one unit."""

    start: int = 0
    at: float = 0.0
    ending: Ending | None = None
    restarts: list[tuple[float, float, bool]] = field(default_factory=list)
    """Restarts that nothing requested: time of the death, of the spawn, whether no node was being
    loaded."""
    streak: int = 0
    may_be_again: bool = False
    """Whether the latest start may have followed from an exit as well as from a request."""
    is_fatal: bool = False
    was_stopped: bool = False
    was_killed: bool = False
    deaths: int = 0
    exits: int = 0
    """How often an exit of the latest start was published."""


class Seen:
    """Watches one machine."""

    def __init__(self, machine: Machine) -> None:
        self._machine = machine
        self.starts: defaultdict[str, Starts] = defaultdict(Starts)
        self.dismissed: set[str] = set()
        self.unsure: set[str] = set()
        """Dismissed ones that a change may have recalled."""
        self.requested: set[str] = set()
        """Units whose next start or load was requested; conditions do not count."""
        self.anew: dict[str, tuple[float, int]] = {}
        """Replacements that were requested: when, and the start or attempt to be replaced."""
        self.attempts: dict[NodeKey, int] = {}
        self.gave_up: set[str] = set()
        """Units that were reported as given up, and not requested since."""
        self.asked: set[str] = set()
        """Those of them that a person requested."""
        self.owed: set[str] = set()
        """Nodes that have to be loaded into their container, whose start was requested."""
        self.killers: defaultdict[NodeKey, int] = defaultdict(int)
        """Deaths of its container in a row while a node was being loaded."""
        self.killed: dict[str, float] = {}
        """When processes were killed that have not exited."""
        self.shown: dict[NodeKey, NodeState] = {}
        self.crashed: dict[NodeKey, int] = {}
        """Nodes whose latest instance crashed: the start of their container."""
        self.stop_reason: str | None = None
        self.stopped_at = 0.0
        self.is_hurried = False
        self.has_changed = self.is_changing = False
        self.changing: set[str] = set()
        """What the change that is being carried out is about."""
        self.unremoved: set[str] = set()
        """What could not be taken out in time, and may go later."""
        self.ends_all: str = ""
        """What has to end the whole system."""
        self.born = machine.now

    def before(self, one: said.Input) -> None:
        """Note an input before the supervisor gets it."""
        now = self._machine.now
        match one:
            case said.StartRequested():
                self._recall(one.unit)
                key = NodeKey.parsed(one.unit) if ":/" in one.unit else None
                if one.anew and key is not None:
                    self.anew[one.unit] = (now, self.attempts.get(key, 0))
                elif one.anew:
                    self.anew[one.unit] = (now, self.starts[one.unit].start)
                    self._stops(one.unit)
            case said.EndRequested():
                self.dismissed.add(one.unit)
                self.unsure.discard(one.unit)
                self._stops(one.unit)
                self.anew.pop(one.unit, None)
            case said.ChangeRequested():
                self._change(one)
            case said.StopRequested():
                if one.is_hurried:
                    self.is_hurried = True
                elif self.stop_reason is None:
                    self.stop_reason, self.stopped_at = one.reason, now
            case said.Failed():
                self.starts[one.unit].is_fatal = True
            case said.Exited() | said.NotStarted():
                self._ends(one)
            case said.NodeReported():
                self._reported(one)
            case _:
                pass

    def _stops(self, unit: str) -> None:
        """Note that a process is not wanted, even if it is too early to stop it."""
        starts = self.starts[unit]
        if starts.start and starts.ending is None:
            starts.was_stopped = True

    def _recall(self, unit: str) -> None:
        self.dismissed.discard(unit)
        self.unsure.discard(unit)
        starts = self.starts[unit]
        is_ending = starts.was_stopped or starts.was_killed or unit in self.gave_up
        if starts.start and starts.ending is None and not is_ending:
            return  # it runs, so nothing is started
        self.requested.add(unit)
        self.asked.add(unit)
        self.gave_up.discard(unit)
        starts.restarts.clear()

    def _change(self, one: said.ChangeRequested) -> None:
        self.has_changed = self.is_changing = True
        self.changing.clear()
        for phase in one.phases:
            for step in phase:
                self.changing.add(step.name)
                self.gave_up.discard(step.name)
                for unit in [each for each in self.anew if step.name in {each, unit_of(each)}]:
                    del self.anew[unit]
                if step.action not in {PlanAction.REMOVE, PlanAction.ADOPT}:
                    # The nodes of a container come with it.
                    recalled = {
                        each for each in self.dismissed if step.name in {each, unit_of(each)}
                    }
                    self.dismissed -= recalled
                    # They are declared anew.
                    self.gave_up -= {each for each in self.gave_up if unit_of(each) == step.name}
                    self.unsure |= recalled

    def _ends(self, one: said.Exited | said.NotStarted) -> None:
        """Note the first report of the end of the latest start."""
        starts = self.starts[one.unit]
        if starts.start != one.start or starts.ending is not None:
            return
        machine, now = self._machine, self._machine.now
        self.killed.pop(one.unit, None)
        proc = machine.processes.last(one.unit)
        exited = isinstance(one, said.Exited)
        was_ready = exited and proc is not None and proc.is_ready
        lived = 0.0
        if exited and proc is not None and was_ready:
            lived = now - (proc.ready_at if proc.is_container else proc.spawned_at)
        shown = machine.view.containers.get(one.unit)
        nodes = shown.nodes.values() if shown is not None else ()
        under_way = frozenset(each.key for each in nodes if each.state in LOADING)
        starts.ending = Ending(
            at=now,
            exit=one.exit if isinstance(one, said.Exited) else None,
            lived=lived,
            was_ready=was_ready,
            is_permanent=isinstance(one, said.NotStarted) and one.is_permanent,
            was_stopped=starts.was_stopped,
            was_killed=starts.was_killed,
            under_way=under_way,
        )
        starts.deaths += 1
        self.owed -= {each for each in self.owed if unit_of(each) == one.unit}
        if not starts.was_stopped and not starts.was_killed and exited:
            for key in under_way:
                self.killers[key] += 1

    def _reported(self, one: said.NodeReported) -> None:
        for key, attempt in self.attempts.items():
            has_crashed = one.said in {"crashed", "load_failed"}  # in its constructor
            if key.container == one.unit and attempt == one.attempt and has_crashed:
                self.crashed[key] = one.start

    def effect(self, effect: said.Effect) -> None:
        """Note an effect after it was judged."""
        machine = self._machine
        match effect:
            case said.Spawn():
                starts = self.starts[effect.unit]
                starts.start, starts.at, starts.ending = effect.start, machine.now, None
                starts.is_fatal = starts.was_stopped = starts.was_killed = False
                starts.exits = 0
                self.requested.discard(effect.unit)
                self.asked.discard(effect.unit)
            case said.Load():
                self.attempts[effect.node] = effect.attempt
                self.crashed.pop(effect.node, None)
                self.owed.discard(str(effect.node))
                self.requested.discard(str(effect.node))
            case said.Stop():
                self.starts[effect.unit].was_stopped = True
            case said.Kill():
                self.starts[effect.unit].was_killed = True
                self.killed[effect.unit] = machine.now
            case StepOutcome():
                if ":/" in effect.step.name:  # it began anew at some moment of the step
                    self.killers.pop(NodeKey.parsed(effect.step.name), None)
                if effect.result is Result.FAILED:
                    self.requested.add(effect.step.name)
                has_failed = (
                    effect.result is Result.FAILED and effect.step.action is PlanAction.REMOVE
                )
                (self.unremoved.add if has_failed else self.unremoved.discard)(effect.step.name)
            case _:
                pass

    def change_ended(self) -> None:
        self.is_changing = False
        self.changing.clear()

    def event(self, event: RunEvent) -> None:
        """Note what was published."""
        match event:
            case ContainerStateChanged(state=State.GAVE_UP):
                self._given_up(event.container)
            case ProcessEvent(kind=ProcessEventKind.GAVE_UP):
                self._given_up(event.name)
            case ProcessEvent(kind=ProcessEventKind.EXITED):
                self.starts[event.name].exits += 1
            case NodeStateChanged():
                was = self.shown.get(event.key)
                self.shown[event.key] = event.state
                if event.state is NodeState.GAVE_UP:
                    self._given_up(str(event.key))
                if was in LOADING and event.state not in {*LOADING, NodeState.LOST}:
                    self.killers.pop(event.key, None)
            case Withdrawn():
                for units in (self.dismissed, self.unsure, self.requested, self.gave_up, self.owed):
                    units.discard(event.key)
                self.anew.pop(event.key, None)
                self.starts[event.key].restarts.clear()
            case _:
                pass

    def _given_up(self, unit: str) -> None:
        if not self.is_requested(unit):
            self.gave_up.add(unit)

    def is_requested(self, unit: str) -> bool:
        """Whether its next start or load is requested by a person, or by a change."""
        return not {unit, unit_of(unit)}.isdisjoint({*self.requested, *self.changing})

    def forgive(self, container: str) -> None:
        """Begin anew with the nodes of a container."""
        for key in [key for key in self.killers if key.container == container]:
            del self.killers[key]
        nodes = {str(key) for key in self._machine.world.nodes if key.container == container}
        self.gave_up -= nodes
        if container in self.asked:
            self.owed |= nodes - self._machine.world.config.start_rules.keys()

    def is_dismissed(self, unit: str) -> bool:
        """Whether it must not run."""
        return unit in self.dismissed

    def is_wanted(self, unit: str) -> bool:
        """Whether it has to run, if it can."""
        return unit not in self.dismissed and unit not in self.unsure
