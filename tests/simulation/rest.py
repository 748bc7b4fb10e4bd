"""Invariants of a system that was left alone for long, and of one that was stopped."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from msgspec.structs import replace

from play_launch import ExitCode
from play_launch.config.dependency import Condition, OnTimeout
from play_launch.config.model import Autostart, ContainerConfig, OnExit
from play_launch.config.node_key import NodeKey
from play_launch.supervisor.events import (
    ContainerState,
    ManagedState,
    NodeState,
    ProcessEventKind,
)
from play_launch.supervisor.view import UNDER_WAY, exit_code, has_failed
from play_launch.supervisor.world import Phase

from .person import unit_of
from .seen import BrokenError

if TYPE_CHECKING:
    from play_launch.config.dependency import Dependency
    from play_launch.supervisor.view import SystemView
    from play_launch.supervisor.world import Process

    from .machine import Machine
    from .seen import Seen
    from .starts import StartChecks

_OVER: Final = frozenset({NodeState.LOAD_FAILED, NodeState.GAVE_UP, NodeState.UNLOADED})
WANTED = "what is wanted is up"
STOPPED = "what is stopped stays stopped"
REASON = "what is given up has a reason"
MANAGED = "a managed node follows its unit"
CODE = "the exit code tells the truth"


class RestChecks:
    """Judges by what the machine has, and by what was published."""

    def __init__(self, machine: Machine, seen: Seen, starts: StartChecks) -> None:
        self._machine = machine
        self._seen = seen
        self._starts = starts

    def at_rest(self) -> None:
        """Judge a system after a long time without any trouble."""
        machine, seen = self._machine, self._seen
        if machine.person.target is not None:
            raise BrokenError("a change comes to its end", str(machine.world.change))
        if seen.stop_reason is not None:
            return
        if seen.ends_all:
            raise BrokenError("an end with consequences ends all", seen.ends_all)
        self._configuration()
        for process in machine.world.processes.values():
            self._process(process)
        for key in machine.world.nodes:
            self._node(key)
        managed = machine.world.config.managed
        if left := machine.world.goals.keys() - managed.keys():
            raise BrokenError(MANAGED, f"{left} are managed by nothing", tuple(left))
        for unit in managed:
            self._goal(unit)

    def _configuration(self) -> None:
        machine = self._machine
        is_ = {*machine.world.processes, *map(str, machine.world.nodes)}
        meant = machine.config.parts
        leaving = self._seen.unremoved | {
            each.name
            for each in machine.world.processes.values()
            if each.is_removed or each.is_stuck or each.next_config is not None
        }
        differs = {each for each in is_ ^ meant.keys() if leaving.isdisjoint({each, unit_of(each)})}
        if differs:
            raise BrokenError("the configuration holds", str(sorted(differs)), tuple(differs))
        for name, each in meant.items():
            process = machine.world.processes.get(name)
            if process is not None and name not in leaving and self._is_old(process.config, each):
                raise BrokenError("the configuration holds", f"{name} has an old one", (name,))

    def _is_old(self, has: object, config: object) -> bool:
        if isinstance(has, ContainerConfig) and isinstance(config, ContainerConfig):
            return replace(has, composable_nodes=()) != replace(config, composable_nodes=())
        return has != config

    def _process(self, process: Process) -> None:
        machine, seen, unit = self._machine, self._seen, process.name
        live = machine.live(unit)
        killable = [each for each in live if not each.ignores_kill]
        if seen.is_dismissed(unit) or process.is_removed:
            if killable:
                raise BrokenError(STOPPED, unit, (unit,))
            return
        if not seen.is_wanted(unit):
            return
        if unit in seen.anew and seen.starts[unit].start == seen.anew[unit][1]:
            stuck = [each for each in live if each.ignores_kill]
            if not stuck and process.phase is not Phase.GAVE_UP:
                raise BrokenError("what is asked for is done", unit, (unit,))
        match process.phase:
            case Phase.RUNNING:
                if not live or not live[-1].is_ready:
                    raise BrokenError(WANTED, f"{unit} does not run", (unit,))
            case Phase.GAVE_UP:
                if not process.reason:
                    raise BrokenError(REASON, unit, (unit,))
                self._given_up(process)
            case Phase.STOPPED:
                self._stopped(process)
            case Phase.QUEUED:
                if process.is_present:
                    self._stays(process)
                else:
                    self._waits(unit)
            case Phase.STARTING if isinstance(process.config, ContainerConfig):
                if not process.config.attach:
                    raise BrokenError(WANTED, f"{unit} starts endlessly", (unit,))
            case _:
                self._stays(process)

    def _stays(self, process: Process) -> None:
        procs = self._machine.processes.of.get(process.name, ())
        if not any(each.is_alive and each.ignores_kill for each in procs):
            text = f"{process.name} stays {process.phase}"
            raise BrokenError(WANTED, text, (process.name,))
        if process.phase in {Phase.KILLING, Phase.STOPPING}:
            text = f"{process.name} stays {process.phase}"
            raise BrokenError("what does not die is given up", text, (process.name,))

    def _given_up(self, process: Process) -> None:
        """Judge whether its restarts were really used up."""
        unit, starts = process.name, self._seen.starts[process.name]
        ending, limits = starts.ending, process.config.restart
        if ending is None or ending.exit is None or self._seen.has_changed:
            return
        is_crash = ending.exit.signal != 0 or ending.exit.code == 1
        is_ended_by = ending.was_stopped or ending.was_killed or starts.is_fatal
        respawns = isinstance(process.config, ContainerConfig) or (
            process.config.on_exit is OnExit.RESTART
        )
        if not is_crash or is_ended_by or not respawns or process.config.on_exit is OnExit.SHUTDOWN:
            return
        recent = [each for each in starts.restarts if ending.at - each[1] < limits.within]
        if len(recent) < limits.max_restarts:
            text = f"{unit} gave up after {len(recent)} of {limits.max_restarts} restarts"
            raise BrokenError("restart bounds hold", text, (unit,))

    def _stopped(self, process: Process) -> None:
        starts = self._seen.starts[process.name]
        if not starts.start:
            raise BrokenError(WANTED, f"{process.name} never ran", (process.name,))
        # It exited unasked, or a node that crashed had it stopped.
        if starts.ending is not None and starts.ending.was_stopped and not process.reason:
            raise BrokenError(WANTED, f"{process.name} is stopped", (process.name,))

    def _node(self, key: NodeKey) -> None:
        machine, seen, unit = self._machine, self._seen, str(key)
        live, there = machine.live(key.container), machine.nodes.of(key)
        state = machine.view.containers[key.container].nodes[key].state
        if seen.is_dismissed(unit):
            hangs = any(each.hangs or each.ignores_kill for each in live)
            if (there and not hangs) or state is not NodeState.UNLOADED:
                raise BrokenError(STOPPED, f"{key}: {state}", (unit,))
            return
        container = machine.world.processes[key.container]
        if container.phase is not Phase.RUNNING:
            if state is NodeState.LOADED:
                raise BrokenError("events tell the truth", f"{key} is {state}", (unit,))
            return
        if not seen.is_wanted(unit) or not seen.is_wanted(key.container):
            return
        hangs = any(each.hangs or each.ignores_kill for each in live)
        if unit in seen.anew and seen.attempts.get(key) == seen.anew[unit][1] and not hangs:
            raise BrokenError("what is asked for is done", unit, (unit,))
        if unit in seen.owed and not hangs:
            text = f"{unit}: {state} although its container was requested"
            raise BrokenError("what is asked for is done", text, (unit,))
        node = machine.world.nodes[key]
        is_loaded = any(each.is_loaded for each in there)
        match state:
            case NodeState.LOADED:
                if not is_loaded:
                    raise BrokenError("events tell the truth", f"{key} is not there", (unit,))
            case NodeState.LOAD_FAILED | NodeState.GAVE_UP:
                pass
            case NodeState.PENDING if node.wait is not None:
                self._waits(unit)
            case NodeState.LOADING | NodeState.REQUESTED | NodeState.UNLOADING:
                # Its constructor hangs, or the whole loader; it is reported again and again.
                if not there or is_loaded:
                    raise BrokenError(WANTED, f"{key} stays {state}", (unit,))
            case NodeState.LOST if node.wait is None:
                raise BrokenError(WANTED, f"{key} stays {state}", (unit,))
            case NodeState.LOST | NodeState.UNLOADED | NodeState.CRASHED:
                if node.wait is not None:
                    self._waits(unit)
                elif not node.reason:
                    raise BrokenError(WANTED, f"{key} stays {state}", (unit,))
            case other:
                raise BrokenError(WANTED, f"{key} stays {other}", (unit,))

    def _waits(self, unit: str) -> None:
        rule = self._machine.world.config.start_rules.get(unit)
        if rule is None:
            raise BrokenError(WANTED, f"{unit} waits for nothing", (unit,))
        missing = [each for each in rule.dependencies if not self._starts.holds(each)]
        if not missing:
            raise BrokenError(WANTED, f"{unit} waits although all holds", (unit,))
        if all(each.unit == "" and not math.isinf(each.timeout) for each in missing):
            raise BrokenError(WANTED, f"{unit} waits longer than it may", (unit,))
        lost = [each for each in missing if self._is_lost(each)]
        if lost == missing or any(each.on_timeout is OnTimeout.FAIL for each in lost):
            text = f"{unit} waits for {lost[0]}, which does not come"
            raise BrokenError(WANTED, text, (unit,))

    def _is_lost(self, dependency: Dependency) -> bool:
        """Whether what a unit waits for is over, until it is requested."""
        machine, unit = self._machine, dependency.unit
        if dependency.machine or not unit:
            return False
        process = machine.world.processes.get(unit_of(unit))
        if process is None or process.phase in {Phase.GAVE_UP, Phase.STOPPED}:
            return True
        goal = machine.world.goals.get(unit)
        if dependency.condition is Condition.ACTIVE and goal and goal.state is ManagedState.FAILED:
            return True
        if ":/" not in unit:
            return False
        return machine.world.nodes[NodeKey.parsed(unit)].state in _OVER

    def _goal(self, unit: str) -> None:
        machine, goal = self._machine, self._machine.world.config.managed[unit]
        has = machine.world.goals.get(unit)
        if has is None or has.config != goal:
            raise BrokenError(MANAGED, f"{unit} has another goal", (unit,))
        name, _, is_node = unit.partition(":/")
        # One that outlives SIGKILL is given up with its nodes.
        is_stuck = name in self._seen.killed
        live = [each for each in machine.live(name) if not (is_stuck and each.ignores_kill)]
        is_up = bool(live) and live[-1].is_ready
        if is_node:
            nodes = [] if not is_up else list(live[-1].nodes.values())
            is_up = any(str(each.key) == unit and each.is_loaded for each in nodes)
        state = has.state
        if goal.autostart is None and state is ManagedState.ASKED:
            state = ManagedState.UNCONFIGURED  # it may never answer
        if is_up is (state is ManagedState.ABSENT):
            raise BrokenError(MANAGED, f"{unit}: {state}", (unit,))
        if state in UNDER_WAY:
            raise BrokenError(MANAGED, f"{unit} stays {state}", (unit,))
        talk = machine.managed.talks.get(unit)
        if is_up and (talk is None or (talk.config, talk.instance) != (goal, has.instance)):
            raise BrokenError(MANAGED, f"{unit} is talked to as another", (unit,))
        short = set() if goal.autostart is None else {ManagedState.UNCONFIGURED}
        if goal.autostart is Autostart.ACTIVATE:
            short.add(ManagedState.INACTIVE)
        again = any(each.startswith(f"answers again: {unit} ") for each in machine.chance.troubles)
        if state in short and not again and unit not in machine.managed.moved:
            raise BrokenError(MANAGED, f"{unit} stays {state}", (unit,))

    # The end.

    def at_end(self, before: SystemView) -> None:
        """Judge a system that was stopped; ``before`` is the view of before the stop."""
        machine, seen = self._machine, self._seen
        name = "after a stop nothing lives"
        if not machine.is_over():
            phases = {
                each.name: each.phase
                for each in machine.world.processes.values()
                if not each.is_at_rest
            }
            raise BrokenError(name, f"it does not end: {phases}", tuple(phases))
        for procs in machine.processes.of.values():
            for proc in procs:
                if proc.is_alive and not proc.ignores_kill:
                    raise BrokenError(name, str(proc), (proc.unit,))
        if machine.person.target is not None:
            raise BrokenError("a change comes to its end", str(machine.world.change))
        code, expected = exit_code(before, machine.view, None), before.expected
        machine.exit_code, machine.before_stop = code, before
        if code == ExitCode.OK:
            down = [
                each.name
                for each in expected.containers.values()
                if each.state is not ContainerState.RUNNING or each.loaded != each.total
            ]
            failed = [name for name, each in expected.processes.items() if has_failed(each)]
            if down or failed:
                raise BrokenError(CODE, f"0, although {down} {failed}")
        if code == ExitCode.NODES_MISSING and not seen.dismissed and not seen.unsure:
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
                raise BrokenError(CODE, "3, although all is up")
