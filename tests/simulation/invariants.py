"""What always holds, each by its name; judged by what the machine saw."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from typing import TYPE_CHECKING

from play_launch.config.dependency import Condition, Otherwise
from play_launch.config.model import ContainerConfig
from play_launch.config.node_key import NodeKey
from play_launch.supervisor import inputs as said
from play_launch.supervisor.events import ContainerState, NodeState, ProcessEventKind
from play_launch.supervisor.exit_code import ExitCode, exit_code
from play_launch.supervisor.goal_life import ManagedState
from play_launch.supervisor.world import STATE_OF_PHASE, Phase

if TYPE_CHECKING:
    from play_launch.config.dependency import Dependency
    from play_launch.supervisor.difference import Snapshot
    from play_launch.supervisor.view import SystemView
    from play_launch.supervisor.world import Process

    from .machine import Machine, Proc

EXCUSED = 3
"""Restarts beyond the limit that the search for the node that kills its container may take."""
PATIENCE = 120.0
"""Seconds after which a load or an unload without an answer was forgotten."""


class BrokenError(AssertionError):
    """An invariant does not hold."""

    def __init__(self, name: str, text: str) -> None:
        super().__init__(f"[{name}] {text}")
        self.name = name


class Checks:
    """Watches one machine."""

    def __init__(self, machine: Machine) -> None:
        self._machine = machine
        self._once: Counter[said.Effect] = Counter()
        self._asked: set[str] = set()
        """Units that an operator or a change started: conditions do not count."""
        self._first: set[str] = set()
        self._waits_since: dict[str, float] = {}
        self._restarts: defaultdict[str, list[float]] = defaultdict(list)
        self._requested: Counter[str] = Counter()
        self._awaited: dict[NodeKey, tuple[NodeState, int, float]] = {}
        self._has_changed = False
        self._hurried = False
        self._is_changing = False
        self._lines: set[tuple[str, str]] = set()

    def after(self, one: said.Input, before: Snapshot, effects: list[said.Effect]) -> None:
        """Judge one step."""
        self._note(one)
        self._is_changing |= self._machine.world.change is not None
        for effect in effects:
            self._effect(effect)
        self._views()
        self._stale(one, before, effects)
        self._isolation(one, before)
        self._answers()
        self._is_changing = self._machine.world.change is not None

    def _note(self, one: said.Input) -> None:
        match one:
            case said.StartRequested():
                self._asked.add(one.unit)
                self._restarts.pop(one.unit, None)
            case said.LoadRequested():
                self._asked.add(str(one.node))
            case said.ChangeRequested():
                self._has_changed = True
            case said.Hurried():
                self._hurried = True
            case said.LineSeen():
                self._lines.add((one.unit, one.pattern))
            case _:
                pass

    # Effects.

    def _effect(self, effect: said.Effect) -> None:
        match effect:
            case said.Raised():
                raise BrokenError("no rule raises", f"{effect.unit}: {effect.error!r}")
            case said.Spawn():
                self._is_once(effect)
                self._spawn(effect)
            case said.Load():
                self._is_once(effect)
                self._conditions(str(effect.node))
                self._load(effect)
            case said.Kill() | said.Stop():
                self._is_once(effect)
                if isinstance(effect, said.Stop):
                    self._reverse_order(effect)
            case _:
                pass

    def _is_once(self, effect: said.Effect) -> None:
        key = (type(effect).__name__, str(effect))
        self._once[key] += 1  # type: ignore[index]
        if self._once[key] > 1:  # type: ignore[index]
            raise BrokenError("every effect is carried out once", str(effect))

    def _spawn(self, effect: said.Spawn) -> None:
        machine, unit = self._machine, effect.unit
        left = [each for each in machine.procs.get(unit, ()) if each.is_alive or not each.is_clean]
        if left:
            raise BrokenError("never two live attempts of a unit", f"{unit}: {left}")
        if machine.world.is_stopping:
            raise BrokenError("nothing starts while the system stops", unit)
        if unit in machine.world.dismissed:
            raise BrokenError("what is stopped stays stopped", unit)
        self._conditions(unit)
        self._bounds(unit)

    def _bounds(self, unit: str) -> None:
        """Count automatic restarts: starts that nothing requested."""
        process = self._machine.world.processes[unit]
        requested = process.attempted
        if self._requested[unit] != requested:
            self._requested[unit] = requested
            self._restarts[unit].clear()
            return
        limits, now = process.config.restart, self._machine.now
        times = [at for at in self._restarts[unit] if now - at < limits.within * 0.99]
        self._restarts[unit] = [*times, now]
        most = limits.max_restarts + (EXCUSED if process.container is not None else 0)
        if limits.max_restarts == 0 or len(times) + 1 > most:
            raise BrokenError("restart bounds hold", f"{unit}: {len(times) + 1} restarts")

    def _load(self, effect: said.Load) -> None:
        machine, key = self._machine, effect.node
        procs = machine.live(key.container)
        if procs and not procs[-1].is_ready:
            raise BrokenError("nothing is loaded before the hello", str(key))
        if str(key) in machine.world.dismissed:
            raise BrokenError("what is stopped stays stopped", str(key))
        there = [
            each
            for proc in procs
            for each in proc.nodes.values()
            if each.key == key and each.is_loaded
        ]
        reported = machine.view.containers[key.container].nodes[key].state
        if there and reported is NodeState.LOADED:
            raise BrokenError("never two live attempts of a unit", str(key))

    def _conditions(self, unit: str) -> None:
        """Judge a first start by what was published, and what the machine knows."""
        if unit in self._first:
            return
        self._first.add(unit)
        rule = self._machine.world.config.start_rules.get(unit)
        if rule is None or unit in self._asked or self._has_changed:
            return
        for dependency in rule.dependencies:
            is_waived = dependency.otherwise is Otherwise.START
            if not self._holds(dependency) and not is_waived:
                text = f"{unit} starts without {dependency}"
                raise BrokenError("nothing starts before its conditions hold", text)

    def _holds(self, dependency: Dependency) -> bool:
        machine = self._machine
        match dependency.condition:
            case Condition.FILE:
                return dependency.subject in machine.files
            case Condition.TOPIC:
                return dependency.subject in machine.topics
            case Condition.LOG:
                return (dependency.unit, dependency.subject) in self._lines
            case Condition.LOADED:
                key = NodeKey.parsed(dependency.unit)
                view = machine.view.containers[key.container].nodes[key]
                return view.state is NodeState.LOADED
            case Condition.STARTED:
                procs = machine.procs.get(dependency.unit, [])
                return bool(procs) and (
                    procs[-1].is_ready or bool(procs[-1].exit and procs[-1].exit.is_ok)
                )
            case other:
                raise NotImplementedError(other)

    def _reverse_order(self, effect: said.Stop) -> None:
        machine = self._machine
        if not machine.world.is_stopping or self._hurried or self._has_changed:
            return
        process = machine.world.processes[effect.unit]
        if process.reason != machine.world.stop_reason:
            return  # it was being stopped before
        units = machine.world.config.units
        for unit, rule in machine.world.config.start_rules.items():
            member = unit.partition(":/")[0]
            for dependency in rule.dependencies:
                needed = dependency.unit.partition(":/")[0]
                if needed == effect.unit and member != needed and member in units:
                    live = [each for each in machine.live(member) if not each.ignores_kill]
                    if live and not self._is_mutual(member, needed):
                        text = f"{effect.unit} is stopped before {member}"
                        raise BrokenError("stops in reverse order", text)

    def _is_mutual(self, one: str, other: str) -> bool:
        """Whether members depend on each other by their nodes, so are stopped together."""
        edges: defaultdict[str, set[str]] = defaultdict(set)
        for unit, rule in self._machine.world.config.start_rules.items():
            for dependency in rule.dependencies:
                if dependency.unit:
                    edges[unit.partition(":/")[0]].add(dependency.unit.partition(":/")[0])
        seen, todo = {other}, [other]
        while todo:
            for each in edges[todo.pop()] - seen:
                seen.add(each)
                todo.append(each)
        return one in seen

    # The world.

    def _views(self) -> None:
        """Compare what was published with what is."""
        world, view = self._machine.world, self._machine.view
        for name, process in world.processes.items():
            if process.container is None:
                continue
            if view.containers[name].state is not STATE_OF_PHASE[process.phase]:
                text = f"{name}: {view.containers[name].state} is {process.phase}"
                raise BrokenError("events tell the truth", text)
        for key, node in world.nodes.items():
            shown = view.containers[key.container].nodes[key]
            if (shown.state, shown.crashes) != (node.state, node.crashes):
                text = f"{key}: {shown.state} is {node.state}"
                raise BrokenError("events tell the truth", text)
        for name in view.containers:
            if name not in world.processes:
                raise BrokenError("events tell the truth", f"{name} is gone")

    def _stale(self, one: said.Input, before: Snapshot, effects: list[said.Effect]) -> None:
        start = getattr(one, "start", None)
        unit = getattr(one, "unit", "")
        old = before.processes.get(unit)
        if start is None or old is None or old.attempt == start:
            return
        new = self._machine.world.processes.get(unit)
        is_waiting = old.wait is not None or old.phase is Phase.QUEUED
        if new != old and not is_waiting:
            raise BrokenError("events of an old attempt change nothing", f"{one}")
        wrong = [each for each in effects if getattr(each, "unit", "") == unit]
        if wrong and not is_waiting:
            raise BrokenError("events of an old attempt change nothing", f"{one}: {wrong}")

    def _isolation(self, one: said.Input, before: Snapshot) -> None:
        if not isinstance(one, said.Exited | said.NodeReported | said.Faulty):
            return
        for name, process in self._machine.world.processes.items():
            old = before.processes.get(name)
            is_stopping = self._machine.world.is_stopping
            if old is None or name == one.unit or is_stopping or self._is_changing:
                continue
            if old.phase in {Phase.RUNNING, Phase.STARTING} and process.phase is not old.phase:
                text = f"{name} goes to {process.phase} because of {one.unit}"
                raise BrokenError("no unit's failure changes another unit", text)
        if isinstance(one, said.NodeReported) and one.said == "crashed":
            self._neighbours(one, before)

    def _neighbours(self, one: said.NodeReported, before: Snapshot) -> None:
        container = self._machine.world.processes.get(one.unit)
        if container is None or container.phase is not Phase.RUNNING:
            return
        for key, node in self._machine.world.nodes.items():
            old = before.nodes.get(key)
            if old is None or old.attempt == one.attempt or key.container != one.unit:
                continue
            if old.state is NodeState.LOADED and node.state is not NodeState.LOADED:
                raise BrokenError("no unit's failure changes another unit", f"{key}")

    def _answers(self) -> None:
        """No request is forgotten: silence leads to a query, and a query to an end."""
        machine = self._machine
        for key, node in machine.world.nodes.items():
            if node.query_at is not None and node.query_at < machine.now - 1.0:
                raise BrokenError("silence is a question", f"{key} in {node.state}")
            awaited = {NodeState.REQUESTED, NodeState.UNLOADING, NodeState.LOADING}
            if node.state in awaited and node.query_at is None:
                raise BrokenError("silence is a question", f"{key} in {node.state}")

    # The end.

    def at_rest(self) -> None:
        """Judge a system after a long time without any trouble."""
        machine = self._machine
        if machine.world.is_stopping:
            return
        for process in machine.world.processes.values():
            self._process_at_rest(process)
        for key, node in machine.world.nodes.items():
            container = machine.world.processes[key.container]
            if str(key) in machine.world.dismissed:
                if node.state is not NodeState.UNLOADED:
                    raise BrokenError("what is stopped stays stopped", f"{key}: {node.state}")
            elif container.phase is Phase.RUNNING:
                self._node_at_rest(key)
        for unit, goal in machine.world.goals.items():
            moving = {ManagedState.CONFIGURING, ManagedState.ACTIVATING}
            if goal.instance and goal.state is ManagedState.ABSENT:
                raise BrokenError("a managed node follows its unit", unit)
            del moving
        if machine.world.change is not None:
            raise BrokenError("a change comes to its end", str(machine.world.change.open))

    def _process_at_rest(self, process: Process) -> None:
        machine = self._machine
        live = machine.live(process.name)
        if process.name in machine.world.dismissed:
            if any(not each.ignores_kill for each in live):
                raise BrokenError("what is stopped stays stopped", process.name)
            return
        match process.phase:
            case Phase.RUNNING:
                if not live:
                    raise BrokenError("what is wanted is up", f"{process.name} does not run")
            case Phase.GAVE_UP:
                if not process.reason:
                    raise BrokenError("what is given up has a reason", process.name)
            case Phase.STOPPED:
                # It exited by itself, or a node that crashed had it stopped.
                if not machine.procs.get(process.name) and not process.reason:
                    raise BrokenError("what is wanted is up", f"{process.name} never ran")
            case Phase.QUEUED:
                self._has_reason_to_wait(process.name)
            case Phase.STARTING if isinstance(process.config, ContainerConfig):
                raise BrokenError("what is wanted is up", f"{process.name} starts for ever")
            case other:
                if not any(each.ignores_kill for each in machine.procs.get(process.name, ())):
                    raise BrokenError("what is wanted is up", f"{process.name} stays {other}")

    def _node_at_rest(self, key: NodeKey) -> None:
        machine = self._machine
        node = machine.world.nodes[key]
        proc: Proc = machine.live(key.container)[-1]
        there = [each for each in proc.nodes.values() if each.key == key and each.is_loaded]
        match node.state:
            case NodeState.LOADED:
                if not there:
                    raise BrokenError("events tell the truth", f"{key} is not there")
            case NodeState.LOAD_FAILED | NodeState.GAVE_UP:
                if not node.reason:
                    raise BrokenError("what is given up has a reason", str(key))
            case NodeState.PENDING if node.wait is not None:
                self._has_reason_to_wait(str(key))
            case NodeState.LOADING:
                # Its constructor hangs; it is reported again and again.
                if not [each for each in proc.nodes.values() if each.key == key]:
                    raise BrokenError("what is wanted is up", f"{key} stays {node.state}")
            case NodeState.LOST | NodeState.UNLOADED | NodeState.CRASHED:
                if node.wait is not None:
                    self._has_reason_to_wait(str(key))
                elif not node.reason:
                    raise BrokenError("what is wanted is up", f"{key} stays {node.state}")
            case other:
                raise BrokenError("what is wanted is up", f"{key} stays {other}")

    def _has_reason_to_wait(self, unit: str) -> None:
        rule = self._machine.world.config.start_rules.get(unit)
        if rule is None:
            raise BrokenError("what is wanted is up", f"{unit} waits for nothing")
        missing = [each for each in rule.dependencies if not self._holds(each)]
        if not missing:
            raise BrokenError("what is wanted is up", f"{unit} waits although all holds")
        if all(each.unit == "" and not math.isinf(each.timeout) for each in missing):
            raise BrokenError("what is wanted is up", f"{unit} waits longer than it may")

    def at_end(self, before: SystemView) -> None:
        """Judge a system that was stopped."""
        machine = self._machine
        if not machine.is_over():
            phases = {name: each.phase for name, each in machine.world.processes.items()}
            raise BrokenError("after a stop nothing lives", f"it does not end: {phases}")
        for procs in machine.procs.values():
            for proc in procs:
                if proc.is_alive and not proc.ignores_kill:
                    raise BrokenError("after a stop nothing lives", str(proc))
        code = exit_code(before, machine.view, None)
        if code == ExitCode.OK:
            expected = before.expected
            down = [
                each.name
                for each in expected.containers.values()
                if each.state is not ContainerState.RUNNING or each.loaded != each.total
            ]
            if down:
                raise BrokenError("the exit code tells the truth", f"0, although {down}")
        if code == ExitCode.NODES_MISSING and not machine.world.dismissed:
            running = all(
                each.state is ContainerState.RUNNING and each.loaded == each.total
                for each in before.containers.values()
            )
            waits = {ProcessEventKind.RESTARTING, ProcessEventKind.WAITING}
            idle = any(each.kind in waits for each in before.processes.values())
            managed = any(
                each.state not in {ManagedState.ACTIVE, ManagedState.INACTIVE}
                for each in before.managed.values()
            )
            if running and not idle and not managed:
                raise BrokenError("the exit code tells the truth", "3, although all is up")
