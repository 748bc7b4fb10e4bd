"""A machine in simulated time that does everything wrong that real ones do."""

from __future__ import annotations

import heapq
import itertools
import random
from typing import TYPE_CHECKING, Final

from play_launch.config.dependency import Condition
from play_launch.supervisor import inputs as said
from play_launch.supervisor.conditions import has_ended
from play_launch.supervisor.difference import events_since
from play_launch.supervisor.plan import StepOutcome
from play_launch.supervisor.reducer import deadline, reduce
from play_launch.supervisor.view import SystemView
from play_launch.supervisor.world import World
from tests.postmortem.scenes import ns

from . import invariants, systems
from .chance import Chance
from .managed import ManagedNodes
from .nodes import Nodes
from .person import Person
from .processes import Processes
from .seen import Snapshot

if TYPE_CHECKING:
    from collections.abc import Callable, Collection

    from play_launch.supervisor.events import RunEvent

    from .processes import Proc

_BEGIN: Final = 1000.0
MOST_STEPS: Final = 4000
"""Inputs of one life; more are a loop."""
QUIET: Final = 900.0
"""Seconds without new troubles, after which a system has to be at rest."""
END: Final = 400.0
"""Seconds that a stop may take: one process after the other."""


class Machine:
    """One life of one system, from a seed."""

    def __init__(self, seed: int, without: Collection[str] = ()) -> None:
        self.chance = Chance(seed, without)
        self.now = _BEGIN
        self.config = systems.system(random.Random(seed))
        self.world = World(self.config, starts=self.chance.choice((1, 2, 16), "starts"))
        self.events: list[RunEvent] = []
        self.view = SystemView()
        self.exit_code = 0
        """Of a system that was stopped."""
        self.before_stop = self.view
        self.trace: list[tuple[float, said.Input, list[said.Effect]]] = []
        self.met: set[tuple[Condition, str, str]] = set()
        """Files and topics that are there, and lines that were written."""
        self.faults = self.chance.choice((0.0, 0.2, 0.5), "faults")
        """How likely everything is to go wrong."""
        self.is_faulty = self.faults > 0.0
        """Whether anything goes wrong at all in this life."""
        self.has_favourites = self.chance.number("favourites") < 0.5
        """Whether some troubles and deeds are frequent in this life, and others do not happen."""
        self._weights: dict[str, float] = {}
        self.steps = 0
        self._due: list[tuple[float, int, Callable[[], None]]] = []
        self._order = itertools.count()
        self._waiting: list[said.Input] = []
        self._is_busy = False
        self.processes = Processes(self)
        self.nodes = Nodes(self)
        self.managed = ManagedNodes(self)
        self.person = Person(self)
        self.checks = invariants.Checks(self)

    # Time.

    def later(self, seconds: float, work: Callable[[], None]) -> None:
        heapq.heappush(self._due, (self.now + seconds, next(self._order), work))

    def run(self, until: float) -> None:
        """Live up to a point in time."""
        while True:
            due = deadline(self.world)
            at = min(
                self._due[0][0] if self._due else float("inf"),
                float("inf") if due is None else due,
            )
            if at > until:
                self.now = until
                return
            self.now = max(self.now, at)
            if self._due and self._due[0][0] <= self.now:
                heapq.heappop(self._due)[2]()
            else:
                self.post(said.Time())

    # Inputs, and the effects that follow.

    def post(self, one: said.Input) -> None:
        self._waiting.append(one)
        if self._is_busy:
            return
        self._is_busy = True
        while self._waiting:
            self._process(self._waiting.pop(0))
        self._is_busy = False

    def post_later(self, seconds: float, one: said.Input) -> None:
        self.later(seconds, lambda: self.post(one))

    def _process(self, one: said.Input) -> None:
        self.steps += 1
        world = self.world
        before = Snapshot(dict(world.processes), dict(world.nodes), dict(world.goals))
        self.checks.before(one)
        effects = reduce(self.world, one, self.now, self.chance.number("jitter"))
        events = self._events()
        self.publish(events)
        self.trace.append((self.now, one, effects))
        if self.steps > MOST_STEPS:
            raise invariants.BrokenError("it comes to rest", "there is always something to do")
        self.checks.after(one, before, effects, events)
        self._forgets_nothing()
        for effect in effects:
            self._carry_out(effect)
        if self.world.change is None:
            self.person.change_ended()

    def _forgets_nothing(self) -> None:
        """Evaluate all units now and then: rules have nothing left to do after an input."""
        due = deadline(self.world)
        if self.steps % 8 or (due is not None and due <= self.now):
            return
        effects = reduce(self.world, said.Time(), self.now, 0.5)
        before = self.world.before
        changed = [*before.processes, *before.nodes, *before.goals]
        changed += before.dismissed ^ self.world.dismissed
        if effects or changed:
            text = f"{changed} {effects}"
            raise invariants.BrokenError("nothing is forgotten", text, tuple(map(str, changed)))

    @property
    def stamp_ns(self) -> int:
        """What the clock on the wall says."""
        return ns(self.now - _BEGIN)

    def _events(self) -> list[RunEvent]:
        return list(events_since(self.world, now=self.now, stamp_ns=self.stamp_ns))

    def publish(self, events: list[RunEvent]) -> None:
        self.events += events
        for event in events:
            self.view = self.view.after(event)

    def begin(self) -> None:
        self.publish(self._events())
        self.post(said.Time())

    def is_unlucky(self, times: float, what: str) -> bool:
        likelihood = self.faults * times * self.weight(what.partition(":")[0])
        return likelihood > 0.0 and self.chance.happens(likelihood, what)

    def weight(self, kind: str) -> float:
        """How often a kind of trouble or deed happens in this life, beside the usual."""
        if not self.has_favourites:
            return 1.0
        if kind not in self._weights:
            self._weights[kind] = self.chance.choice((0.0, 0.0, 1.0, 3.0), f"weight: {kind}")
        return self._weights[kind]

    def soon(self, longest: float, what: str) -> float:
        is_slow = self.is_unlucky(0.2, f"slow: {what}")
        return self.chance.number(f"time: {what}") * longest * (20 if is_slow else 1)

    def _carry_out(self, effect: said.Effect) -> None:
        match effect:
            case said.Spawn():
                self.processes.spawn(effect.unit, effect.start)
            case said.Kill():
                self.processes.kill(effect.unit, effect.start)
            case said.Stop():
                self.processes.stop(effect.unit, effect.start)
            case said.Load():
                self.nodes.load(effect.node, effect.attempt)
            case said.Unload():
                self.nodes.unload(effect.container, effect.unique_id)
            case said.Query():
                self.nodes.query(effect)
            case said.Probe():
                self.nodes.probe(effect.nodes)
            case said.Drive():
                self.managed.drive(effect)
            case said.SetParameters():
                self.person.set_parameters(effect)
            case StepOutcome():
                self.person.step_ended(effect)
            case said.End():
                self.post(said.StopRequested(effect.reason))
            case _:
                pass

    def live(self, unit: str) -> list[Proc]:
        return self.processes.live(unit)

    # The world outside.

    def touch_file(self) -> None:
        self.touch((Condition.FILE, "", self.chance.choice(systems.FILES, "file")))

    def touch_topic(self) -> None:
        self.touch((Condition.TOPIC, "", self.chance.choice(systems.TOPICS, "topic")))

    def touch_far(self) -> None:
        kind = self.chance.choice(systems.FAR_KINDS, "far condition")
        self.touch((kind, self.chance.choice(systems.FAR, "far unit"), ""))

    def touch(self, condition: tuple[Condition, str, str]) -> None:
        self.met ^= {condition}
        self.post(said.Found(frozenset(self.met)))

    def write(self, line: tuple[Condition, str, str]) -> None:
        self.met.add(line)
        self.post(said.Found(frozenset(self.met)))

    def is_over(self) -> bool:
        return has_ended(self.world)


def live(seed: int, without: Collection[str] = ()) -> Machine:
    """Live one life: troubles, mostly then quiet, then the end; raises BrokenError."""
    return lived(Machine(seed, without))


def lived(machine: Machine) -> Machine:
    """The same for a machine that was made."""
    chance = machine.chance
    machine.begin()
    for _ in range(int(chance.number("deeds") * 60)):
        pause = chance.number("pause") * chance.choice((0.5, 10.0), "pauses")
        machine.run(machine.now + pause)
        if machine.world.is_stopping:
            break
        machine.person.meddle()
    if chance.number("quiet") < 0.8:
        machine.faults = 0.0
        machine.run(machine.now + QUIET)
        machine.checks.at_rest()
    before = machine.view
    if not machine.world.is_stopping:
        machine.post(said.StopRequested("the simulation is over"))
        if chance.happens(0.2, "hurry"):
            machine.post(said.StopRequested(is_hurried=True))
    machine.run(machine.now + END)
    machine.checks.at_end(before)
    return machine
