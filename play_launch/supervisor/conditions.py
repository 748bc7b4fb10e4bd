"""Conditions of starts and loads, as functions of the world: which are met, pending, impossible.

Conditions are for the first start. Once a unit was released, or an operator has started it, its
automatic restarts wait for nothing.
"""

from __future__ import annotations

from enum import StrEnum, auto
from typing import TYPE_CHECKING, Final, NamedTuple

from msgspec.structs import replace

from play_launch.config.dependency import Condition, Dependency, DependencyGraph, OnTimeout
from play_launch.config.model import Autostart
from play_launch.config.node_key import NodeKey
from play_launch.supervisor.events import ManagedState, NodeState
from play_launch.supervisor.world import (
    INACTIVE,
    Node,
    Phase,
    Process,
    Wait,
    World,
    is_wanted,
)

if TYPE_CHECKING:
    from play_launch.config.dependency import StartRule
    from play_launch.supervisor.reducer import Reduction


class ConditionState(StrEnum):
    """State of a condition."""

    MET = auto()
    PENDING = auto()
    IMPOSSIBLE = auto()
    """It cannot be met unless an operator intervenes."""


class Evaluation(NamedTuple):
    """State of a condition; the reason is empty unless it is IMPOSSIBLE."""

    state: ConditionState
    reason: str = ""


MET: Final = Evaluation(ConditionState.MET)
PENDING: Final = Evaluation(ConditionState.PENDING)

_EXISTS: Final = {
    Condition.STARTED: frozenset({NodeState.LOADING, NodeState.LOADED}),
    Condition.LOADED: frozenset({NodeState.LOADED}),
}
_GONE: Final = {
    NodeState.LOAD_FAILED: "it failed to load",
    NodeState.CRASHED: "it crashed",
    NodeState.GAVE_UP: "it is not loaded again",
    NodeState.UNLOADED: "it was unloaded",
    NodeState.UNLOADING: "it is being unloaded",
}


def unit_key(unit: Process | Node) -> str:
    """Give the name of a process, or the text of the key of a node, as rules have it."""
    return unit.name if isinstance(unit, Process) else str(unit.key)


def rule_of(world: World, unit: Process | Node) -> StartRule | None:
    """Give the rule that holds the unit back; None: it waits for nothing."""
    if unit.released_at is not None:
        return None
    return world.config.start_rules.get(unit_key(unit))


class Readiness(NamedTuple):
    """Whether a unit may start."""

    may_start: bool
    wait: Wait | None
    failure: str = ""
    """Why it never may."""


def readiness(world: World, unit: Process | Node, now: float) -> Readiness:
    """Evaluate the conditions of a unit that is to start; its wait begins now, if it has not."""
    rule = rule_of(world, unit)
    if rule is None:
        return Readiness(may_start=True, wait=None)
    wait = unit.wait or Wait(since=now, report_due=now + world.limits.report_interval)
    pending: list[Dependency] = []
    waived: list[str] = []
    times: list[float] = []
    for dependency in rule.dependencies:
        state, reason = condition_state(world, dependency)
        if state is ConditionState.MET:
            continue
        if state is ConditionState.PENDING:
            deadline = _deadline(world, wait, dependency)
            if deadline is None or now < deadline:
                pending.append(dependency)
                if deadline is not None:
                    times.append(deadline)
                continue
            reason = f"not within {dependency.timeout:g} s"
        text = f"it waited for {dependency}: {reason}"
        if dependency.on_timeout is OnTimeout.FAIL:
            return Readiness(may_start=False, wait=None, failure=text)
        waived.append(text)
    if pending:
        text = f"waits for {', '.join(map(str, pending))}"
        after = replace(wait, met_since=None, text=text, next_at=min(times, default=None))
        return Readiness(may_start=False, wait=after)
    met_since = now if wait.met_since is None else wait.met_since
    if now >= met_since + rule.delay:
        return Readiness(may_start=True, wait=replace(wait, waived="; ".join(waived)))
    text = f"waits for its delay of {rule.delay:g} s"
    after = replace(wait, met_since=met_since, text=text, next_at=met_since + rule.delay)
    return Readiness(may_start=False, wait=after)


def _deadline(world: World, wait: Wait, dependency: Dependency) -> float | None:
    """When a condition is given up; None while its unit waits itself, or without a limit."""
    if dependency.timeout == float("inf"):
        return None
    unit = find_unit(world, dependency.unit)
    if unit is not None and unit.wait is not None:
        return None
    released = None if unit is None else unit.released_at
    since = wait.since if released is None else max(wait.since, released)
    return since + dependency.timeout


def find_unit(world: World, name: str) -> Process | Node | None:
    """Find a process by name, or a node by the text of its key."""
    if name in world.processes:
        return world.processes[name]
    return world.nodes.get(NodeKey.parsed(name)) if ":/" in name else None


def condition_state(world: World, dependency: Dependency) -> Evaluation:
    condition, name = dependency.condition, dependency.unit
    if not name:
        return MET if _is_met_outside(world, dependency) else PENDING
    if condition is Condition.ACTIVE and (goal := world.goals.get(name)) is not None:
        if goal.state is ManagedState.ACTIVE:
            return MET
        if goal.state is ManagedState.FAILED:
            return Evaluation(ConditionState.IMPOSSIBLE, goal.reason)
    unit = find_unit(world, name)
    match unit:
        case None:
            return _impossible("it is no longer in the configuration")
        case Node():
            if condition is Condition.ACTIVE:
                found = _of_node(world, unit, Condition.LOADED)
                return PENDING if found.state is ConditionState.MET else found
            return _of_node(world, unit, condition)
        case Process():
            if condition in {Condition.STARTED, Condition.EXITED}:
                return _of_process(world, unit, condition)
            if condition is Condition.LOADED and unit.container is not None:
                return _of_all_nodes(world, unit)
            if condition is Condition.LOG and (name, dependency.subject) in world.lines:
                return MET
            return _of_output(world, unit)


def _is_met_outside(world: World, dependency: Dependency) -> bool:
    if dependency.condition is Condition.FILE:
        return dependency.subject in world.files
    return (dependency.condition, dependency.subject) in world.graph


def _of_process(world: World, process: Process, condition: Condition) -> Evaluation:
    if process.phase is Phase.RUNNING:
        return MET if condition is Condition.STARTED else PENDING
    if process.phase is Phase.GAVE_UP:
        return _impossible("it gave up", process.reason)
    is_leaving = process.phase in {Phase.STOPPED, Phase.STOPPING}
    if process.phase is Phase.STOPPED and process.exit is not None and process.container is None:
        if process.exit.is_ok:
            return MET
        return _impossible("it ended", process.exit.text)
    if is_leaving and process.generation <= process.attempted:
        return _impossible("it is stopped", process.reason)
    return PENDING if is_wanted(world, process) else _impossible("it is stopped", process.reason)


def _of_node(world: World, node: Node, condition: Condition) -> Evaluation:
    if node.state in _EXISTS[condition]:
        return MET
    found = _of_process(world, world.processes[node.key.container], Condition.STARTED)
    if found.state is ConditionState.IMPOSSIBLE:
        return _impossible("its container", found.reason)
    returns = node.next_at is not None and not node.gives_up
    if node.state in _GONE and not returns and node.generation <= node.attempted:
        return _impossible(_GONE[node.state], node.reason)
    return PENDING


def _of_all_nodes(world: World, container: Process) -> Evaluation:
    result = _of_process(world, container, Condition.STARTED)
    for node in world.nodes_of(container.name):
        found = _of_node(world, node, Condition.LOADED)
        if ConditionState.IMPOSSIBLE is found.state is not result.state:
            return _impossible(node.key.name, found.reason)
        if found.state is ConditionState.PENDING and result.state is ConditionState.MET:
            result = PENDING
    return result


def _of_output(world: World, process: Process) -> Evaluation:
    """Evaluate what a process does while it runs, and has not done: a line, a state."""
    found = _of_process(world, process, Condition.STARTED)
    if found.state is ConditionState.MET and process.is_at_rest:
        return _impossible("it ended")
    if found.state is ConditionState.MET or not process.is_at_rest:
        return PENDING  # its last lines are still to be read
    return found


def _impossible(what: str, why: str = "") -> Evaluation:
    return Evaluation(ConditionState.IMPOSSIBLE, f"{what}: {why}" if why else what)


def awaited_dependencies(world: World) -> tuple[Dependency, ...]:
    """Give the conditions of all units that wait now, met or not, each once."""
    keys = sorted(world.waiting, key=world.places.__getitem__)
    units = [world.processes[key] if isinstance(key, str) else world.nodes[key] for key in keys]
    waiting = [unit for unit in units if unit.wait is not None]
    found = [
        dependency
        for unit in waiting
        if (rule := rule_of(world, unit)) is not None
        for dependency in rule.dependencies
    ]
    return tuple(dict.fromkeys(found))


def stopped_before(world: World) -> dict[str, frozenset[str]]:
    """Name for each process those that are stopped before it: they depend on it."""
    units: dict[str, tuple[str, ...]] = {
        name: tuple(str(node.key) for node in world.nodes_of(name)) for name in world.processes
    }
    return DependencyGraph(world.config.start_rules, units).stopped_after()


_GOAL_REACHED: Final = frozenset({ManagedState.ACTIVE, ManagedState.FINALIZED, ManagedState.FAILED})


def has_arrived(world: World, unit: Process | Node) -> bool:
    """Whether a unit is up, or failed for good."""
    key = unit_key(unit)
    if key in world.arrived:
        return True
    condition = Condition.STARTED if isinstance(unit, Process) else Condition.LOADED
    state = condition_state(world, Dependency(condition=condition, unit=key)).state
    goal = world.goals.get(key)
    if state is ConditionState.MET and goal is not None and goal.config.autostart is not None:
        is_enough = goal.config.autostart is Autostart.CONFIGURE
        return goal.state in _GOAL_REACHED or (is_enough and goal.state is ManagedState.INACTIVE)
    return state is not ConditionState.PENDING


def pending_units(world: World) -> tuple[str, ...]:
    """Name the units that have neither been up nor failed for good; dismissed ones excluded."""
    found = []
    for process in world.processes.values():
        if process.name in world.dismissed:
            continue
        units: list[Process | Node] = [process, *world.nodes_of(process.name)]
        found += [
            unit_key(unit)
            for unit in units
            if unit_key(unit) not in world.dismissed and not has_arrived(world, unit)
        ]
    return tuple(found)


def nothing_is_left(world: World) -> bool:
    """Whether nothing runs, no start is pending, and no operator may request one."""
    if world.change is not None or any(name in world.dismissed for name in world.processes):
        return False
    return all(
        process.is_at_rest
        and not (is_wanted(world, process) and process.generation > process.attempted)
        for process in world.processes.values()
    )


def has_ended(world: World) -> bool:
    return world.is_stopping and all(
        process.phase in INACTIVE and process.is_at_rest for process in world.processes.values()
    )


def report_wait(step: Reduction, name: str, before: Wait | None, wait: Wait) -> Wait:
    """Warn of a unit that waits for long."""
    if before is None or step.now < wait.report_due:
        return wait
    text = f"{name} has waited for {step.now - wait.since:.0f} s: it {wait.text}"
    step.log(text, is_shown_otherwise=True)
    return replace(wait, report_due=step.now + step.world.limits.report_interval)
