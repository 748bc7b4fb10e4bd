"""A machine in simulated time that does everything wrong that real ones do."""

from __future__ import annotations

import heapq
import itertools
import random
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from play_launch.config.dependency import Condition
from play_launch.supervisor import inputs as said
from play_launch.supervisor.conditions import has_ended
from play_launch.supervisor.difference import NOTHING, Snapshot, events_between
from play_launch.supervisor.goal_life import ManagedInput
from play_launch.supervisor.node_life import NodeFact
from play_launch.supervisor.plan import plan
from play_launch.supervisor.reducer import deadline, reduce
from play_launch.supervisor.steps import after
from play_launch.supervisor.view import SystemView
from play_launch.supervisor.world import Exit, Hello, World

from . import invariants, systems

if TYPE_CHECKING:
    from collections.abc import Callable

    from play_launch.config.model import ReplayConfig
    from play_launch.config.node_key import NodeKey
    from play_launch.supervisor.events import RunEvent

MOST_STEPS = 4000
"""Inputs of one life; more are a loop."""


@dataclass
class Loaded:
    """A node as its container has it."""

    key: NodeKey
    attempt: int
    unique_id: int
    is_loaded: bool = False


@dataclass
class Proc:
    """A process as the machine has it."""

    unit: str
    start: int
    pid: int
    is_alive: bool = True
    is_ready: bool = False
    is_clean: bool = False
    ignores_kill: bool = False
    exit: Exit | None = None
    nodes: dict[int, Loaded] = field(default_factory=dict)
    ids: Any = field(default_factory=lambda: itertools.count(1))


class Machine:
    """One life of one system, from a seed."""

    def __init__(self, seed: int) -> None:
        self.chance = random.Random(seed)
        self.now = 1000.0
        self.config = systems.system(self.chance)
        self.world = World(self.config, starts=self.chance.choice((1, 2, 16)))
        self.view = SystemView()
        self.procs: dict[str, list[Proc]] = {}
        self.trace: list[str] = []
        self.files: set[str] = set()
        self.topics: set[str] = set()
        self.faults = self.chance.choice((0.0, 0.2, 0.5))
        """How likely everything is to go wrong."""
        self.steps = 0
        self._pids = itertools.count(100)
        self._due: list[tuple[float, int, Callable[[], None]]] = []
        self._order = itertools.count()
        self._waiting: list[said.Input] = []
        self._is_busy = False
        self.checks = invariants.Checks(self)
        self.target: ReplayConfig | None = None
        self.done: list[said.StepEnded] = []

    # Time.

    def later(self, seconds: float, work: Callable[[], None]) -> None:
        heapq.heappush(self._due, (self.now + seconds, next(self._order), work))

    def run(self, until: float) -> None:
        """Live up to a point in time."""
        while True:
            at = min(
                self._due[0][0] if self._due else float("inf"),
                deadline(self.world) or float("inf"),
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

    def _process(self, one: said.Input) -> None:
        self.steps += 1
        if self.steps > MOST_STEPS:
            raise invariants.BrokenError("it ends", "the supervisor does not come to rest")
        self.trace.append(f"{self.now:9.3f} {one}")
        before = Snapshot.of(self.world)
        effects = reduce(self.world, one, self.now, self.chance.random())
        events = list(events_between(before, self.world, now=self.now, stamp_ns=0))
        self._publish(events)
        self.trace += [f"          -> {each}" for each in effects]
        self.checks.after(one, before, effects)
        for effect in effects:
            self.carry_out(effect)

    def _publish(self, events: list[RunEvent]) -> None:
        for event in events:
            self.view = self.view.after(event)

    def begin(self) -> None:
        self._publish(list(events_between(NOTHING, self.world, now=self.now, stamp_ns=0)))
        self.post(said.Begun())

    def is_unlucky(self, times: float = 1.0) -> bool:
        return self.chance.random() < self.faults * times

    def soon(self, longest: float = 1.0) -> float:
        return self.chance.random() * (longest * 20 if self.is_unlucky(0.2) else longest)

    def carry_out(self, effect: said.Effect) -> None:
        match effect:
            case said.Spawn():
                self.spawn(effect.unit, effect.start)
            case said.Kill():
                self.kill(self.proc(effect.unit, effect.start))
            case said.Stop():
                self.stop(self.proc(effect.unit, effect.start))
            case said.Load():
                self.load(effect.node, effect.attempt)
            case said.Cancel() | said.Unload():
                self.unload(effect.container, effect.unique_id)
            case said.Query():
                self.query(effect)
            case said.Probe():
                for key in effect.nodes:
                    self.later(self.soon(5.0), lambda key=key: self.post(self.probed(key)))  # type: ignore[misc]
            case said.Drive():
                self.drive(effect.unit, effect.instance, (ManagedInput.IS_UNCONFIGURED,))
            case said.Transit():
                self.transit(effect)
            case said.SetParameters():
                refusal = "it is read only" if self.is_unlucky() else ""
                answer = said.ParametersSet(effect.step, refusal)
                self.later(self.soon(), lambda: self.post(answer))
            case said.StepEnded():
                self.done.append(effect)
            case said.ChangeEnded():
                self.change_ended()
            case said.End():
                self.post(said.StopRequested(effect.reason))
            case _:
                pass

    # Processes.

    def live(self, unit: str) -> list[Proc]:
        return [each for each in self.procs.get(unit, ()) if each.is_alive]

    def proc(self, unit: str, start: int) -> Proc | None:
        found = [each for each in self.procs.get(unit, ()) if each.start == start]
        return found[0] if found else None

    def spawn(self, unit: str, start: int) -> None:
        if self.is_unlucky(0.2):
            answer = said.NotStarted(unit, start, "no memory", is_permanent=self.is_unlucky(0.3))
            self.later(self.soon(), lambda: self.post(answer))
            return
        proc = Proc(unit, start, next(self._pids), ignores_kill=self.is_unlucky(0.02))
        self.procs.setdefault(unit, []).append(proc)
        self.later(self.soon(0.1), lambda: self.started(proc))

    def started(self, proc: Proc) -> None:
        if not proc.is_alive:
            return
        known = self.world.processes.get(proc.unit)
        proc.is_ready = known is not None and known.container is None
        self.post(said.Started(proc.unit, proc.start, proc.pid, 1))
        if self.is_unlucky(0.6):
            code, signal = self.chance.choice(((0, 0), (1, 0), (127, 0), (0, 11)))
            self.later(self.soon(20.0), lambda: self.end(proc, code, signal))
        if proc.unit not in self.world.processes:
            return
        if proc.is_ready:
            if not self.is_unlucky():
                line = said.LineSeen(proc.unit, "ready")
                self.later(self.soon(), lambda: self.post(line))
        elif not self.is_unlucky(0.1):
            self.later(self.soon(), lambda: self.greet(proc))

    def greet(self, proc: Proc) -> None:
        if not proc.is_alive:
            return
        if self.is_unlucky(0.05):
            self.post(said.Faulty(proc.unit, proc.start, "version 7", is_fatal=True))
            return
        proc.is_ready = True
        self.post(said.Greeted(proc.unit, proc.start, Hello("shared_memory", "isolated")))
        if self.is_unlucky(0.1):
            fault = said.Faulty(proc.unit, proc.start, "it is frozen")
            self.later(self.soon(30.0), lambda: self.post(fault))

    def end(self, proc: Proc, code: int = 0, signal: int = 0) -> None:
        if not proc.is_alive:
            return
        proc.is_alive = False
        proc.exit = Exit(f"exited with {code or signal}", code, signal)
        for each in list(proc.nodes.values()):
            if self.is_unlucky(0.3):  # its last words, which may come doubled or not at all
                self.report(proc, each, NodeFact.UNLOADED)
        exited, clean = said.Exited(proc.unit, proc.start, proc.exit), self.soon(0.5)
        self.later(clean, lambda: self.post(exited))
        self.later(clean + self.soon(2.0), lambda: self.clean(proc))

    def clean(self, proc: Proc) -> None:
        proc.is_clean = True
        self.post(said.CleanedUp(proc.unit, proc.start))
        if self.is_unlucky():
            self.post(said.CleanedUp(proc.unit, proc.start))

    def kill(self, proc: Proc | None) -> None:
        if proc is not None and not self.world.processes[proc.unit].is_started:
            if self.chance.random() < 0.7:  # else its pid is on its way
                proc.is_alive, proc.is_clean = False, True
                self.post(said.NotStarted(proc.unit, proc.start, "cancelled", is_permanent=False))
            return
        if proc is not None and proc.is_alive and not proc.ignores_kill:
            self.later(self.soon(0.1), lambda: self.end(proc, signal=9))

    def stop(self, proc: Proc | None) -> None:
        if proc is None or not proc.is_alive:
            return
        if proc.ignores_kill:
            self.later(10.0, lambda: self.post(said.Unkillable(proc.unit, proc.start)))
            self.later(60.0, lambda: self.end(proc, signal=9))
            return
        self.later(self.soon(1.0), lambda: self.end(proc, signal=2))

    # Nodes.

    def report(self, proc: Proc, node: Loaded, fact: NodeFact, **values: Any) -> None:
        one = said.NodeReported(
            unit=proc.unit,
            start=proc.start,
            said=fact,
            attempt=node.attempt,
            unique_id=node.unique_id,
            **values,
        )
        if self.is_unlucky(0.1):
            return  # lost
        self.post(one)
        if self.is_unlucky(0.2):
            self.later(self.soon(5.0), lambda: self.post(one))  # doubled, and late

    def load(self, key: NodeKey, attempt: int) -> None:
        procs = self.live(key.container)
        if not procs or self.is_unlucky(0.05):
            return  # the request is lost
        proc = procs[-1]
        node = Loaded(key, attempt, next(proc.ids))
        if self.is_unlucky(0.1):
            self.later(self.soon(), lambda: self.report(proc, node, NodeFact.REJECTED, reason="no"))
            return
        proc.nodes[node.unique_id] = node
        self.later(self.soon(0.1), lambda: self.if_there(proc, node, NodeFact.ACCEPTED))
        if self.is_unlucky(0.1):
            return  # its constructor hangs
        if self.is_unlucky(0.1):
            self.later(self.soon(), lambda: self.end(proc, signal=11))
            return
        self.later(self.soon(), lambda: self.construct(proc, node))

    def if_there(self, proc: Proc, node: Loaded, fact: NodeFact, **values: Any) -> None:
        if proc.is_alive and node.unique_id in proc.nodes:
            self.report(proc, node, fact, **values)

    def construct(self, proc: Proc, node: Loaded) -> None:
        if not proc.is_alive or node.unique_id not in proc.nodes:
            return
        fate = self.chance.random()
        if fate < self.faults * 0.2:
            del proc.nodes[node.unique_id]
            self.report(proc, node, NodeFact.LOAD_FAILED, reason="no device")
            return
        if fate < self.faults * 0.4:
            self.crash(proc, node)
            return
        node.is_loaded = True
        self.report(proc, node, NodeFact.LOADED, pid=proc.pid)
        if self.is_unlucky(0.5):
            self.later(self.soon(30.0), lambda: self.crash(proc, node))

    def crash(self, proc: Proc, node: Loaded) -> None:
        if proc.is_alive and node.unique_id in proc.nodes:
            del proc.nodes[node.unique_id]
            self.report(proc, node, NodeFact.CRASHED, reason="signal 11", signal=11)

    def unload(self, container: str, unique_id: int) -> None:
        procs = self.live(container)
        if not procs:
            return
        proc = procs[-1]
        node = proc.nodes.pop(unique_id, None)
        if node is None:
            one = said.NodeReported(
                unit=container,
                start=proc.start,
                said=NodeFact.UNLOAD_REJECTED,
                unique_id=unique_id,
            )
            self.later(self.soon(), lambda: self.post(one))
            return
        self.later(self.soon(), lambda: self.report(proc, node, NodeFact.UNLOADED))

    def query(self, effect: said.Query) -> None:
        procs = self.live(effect.container)
        if not procs or self.is_unlucky(0.1):
            return
        proc = procs[-1]
        self.later(self.soon(), lambda: self.answer(proc, effect))

    def answer(self, proc: Proc, effect: said.Query) -> None:
        if not proc.is_alive:
            return
        for key, attempt, unique_id in effect.about:
            found = [each for each in proc.nodes.values() if each.attempt == attempt]
            node = found[0] if found else Loaded(key, attempt, unique_id)
            fact = NodeFact.STATUS_UNKNOWN
            if found:
                fact = NodeFact.STATUS_LOADED if node.is_loaded else NodeFact.STATUS_CONSTRUCTING
            self.report(proc, node, fact)

    def probed(self, key: NodeKey) -> said.Probed:
        from play_launch.supervisor.inputs import ProbeResult

        finding = ProbeResult(loads=False, error="no symbol") if self.is_unlucky(0.3) else None
        return said.Probed(key, finding)

    # Managed nodes.

    def drive(self, unit: str, instance: int, facts: tuple[ManagedInput, ...]) -> None:
        for fact in facts:
            if not self.is_unlucky(0.1):
                one = said.GoalReported(unit, instance, fact, "")
                self.later(self.soon(), lambda one=one: self.post(one))  # type: ignore[misc]

    def transit(self, effect: said.Transit) -> None:
        leads_to = (
            ManagedInput.IS_INACTIVE if effect.action == "configure" else ManagedInput.IS_ACTIVE
        )
        fact = ManagedInput.REFUSED if self.is_unlucky(0.2) else leads_to
        self.drive(effect.unit, effect.instance, (fact,))

    # A person, and the world outside.

    def meddle(self) -> None:
        """Do one thing that a person or the world outside does."""
        names, keys = list(self.world.processes), list(self.world.nodes)
        deeds: list[Callable[[], None]] = [self._touch_file, self._touch_topic, self._change]
        if names:
            name = self.chance.choice(names)
            deeds += [
                lambda: self.post(said.StartRequested(name)),
                lambda: self.post(said.EndRequested(name, "a person asked for it")),
                lambda: self.post(said.StartRequested(name, anew=True, reason="for a test")),
            ]
        if keys:
            key = self.chance.choice(keys)
            deeds += [
                lambda: self.post(said.LoadRequested(key)),
                lambda: self.post(said.UnloadRequested(key)),
                lambda: self.post(said.LoadRequested(key, anew=True)),
            ]
        self.chance.choice(deeds)()

    def _touch_file(self) -> None:
        self.files ^= {self.chance.choice(systems.FILES)}
        self.post(said.FilesSeen(frozenset(self.files)))

    def _touch_topic(self) -> None:
        self.topics ^= {self.chance.choice(systems.TOPICS)}
        self.post(said.GraphSeen(frozenset((Condition.TOPIC, each) for each in self.topics)))

    def _change(self) -> None:
        if self.target is not None or self.world.is_stopping or self.world.is_ending:
            return
        self.target = systems.changed(self.chance, self.config)
        found = plan(self.config, self.target, {})
        self.done = []
        self.post(said.ChangeRequested(self.target, found.phases(), 30.0))

    def change_ended(self) -> None:
        assert self.target is not None
        done = [each.step for each in self.done if each.is_done]
        self.config = after(self.config, self.target, done)
        self.target = None

    def is_over(self) -> bool:
        return has_ended(self.world)


def live(seed: int) -> Machine:
    """Live one life: troubles, then quiet, then the end; raises BrokenError."""
    machine = Machine(seed)
    machine.begin()
    for _ in range(machine.chance.randrange(60)):
        machine.run(machine.now + machine.chance.random() * machine.chance.choice((0.5, 10.0)))
        if machine.world.is_stopping:
            break
        machine.meddle()
    machine.faults = 0.0
    machine.run(machine.now + 900.0)
    machine.checks.at_rest()
    before = machine.view
    if not machine.world.is_stopping:
        machine.post(said.StopRequested("the simulation is over"))
        if machine.chance.random() < 0.2:
            machine.post(said.Hurried())
    machine.run(machine.now + 300.0)
    machine.checks.at_end(before)
    return machine
