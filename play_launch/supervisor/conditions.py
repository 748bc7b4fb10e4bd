"""Conditions of starts and loads, as functions of the world.

The state of a condition is a text: empty when it is met, None when it is pending, else why it
cannot be met unless an operator intervenes.

Conditions are for the first start. Once a unit was released, or an operator has started it, its
automatic restarts wait for nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from msgspec.structs import replace

from play_launch.config.dependency import Condition, Dependency, DependencyGraph, OnTimeout
from play_launch.config.model import Autostart
from play_launch.supervisor.events import ManagedState, NodeState
from play_launch.supervisor.outcome import described
from play_launch.supervisor.world import INACTIVE, Node, Phase, Process, Wait, is_wanted

if TYPE_CHECKING:
    from play_launch.config.dependency import StartRule
    from play_launch.config.model import ReplayConfig
    from play_launch.supervisor.reducer import Reduction
    from play_launch.supervisor.world import World


_GONE: Final = {
    NodeState.LOAD_FAILED: "it failed to load",
    NodeState.CRASHED: "it crashed",
    NodeState.GAVE_UP: "it is not loaded again",
    NodeState.UNLOADED: "it was unloaded",
    NodeState.UNLOADING: "it is being unloaded",
}


def rule_of(world: World, unit: Process | Node) -> StartRule | None:
    """Give the rule that holds the unit back; None: it waits for nothing."""
    is_released = unit.released_at is not None
    return None if is_released else world.config.start_rules.get(str(unit.key))


def may_start(step: Reduction, unit: Process | Node) -> str | None:
    """Evaluate the conditions of a unit that is to start, as one; its wait begins or ends."""
    world, now, rule = step.world, step.now, rule_of(step.world, unit)
    if rule is None:
        world.put(unit, wait=None)
        return ""
    wait = unit.wait or Wait(since=now, report_due=now + world.limits.report_interval)
    pending: list[Dependency] = []
    waived: list[str] = []
    times: list[float] = []
    for dependency in rule.dependencies:
        state = condition_state(world, dependency)
        if state == "":
            continue
        if state is None:
            deadline = _deadline(world, wait, dependency)
            if deadline is None or now < deadline:
                pending.append(dependency)
                times += [] if deadline is None else [deadline]
                continue
            state = f"not within {dependency.timeout:g} s"
        text = f"it waited for {dependency}: {state}"
        if dependency.on_timeout is OnTimeout.FAIL:
            world.put(unit, wait=None)
            return text
        waived.append(text)
    if pending:
        text = f"waits for {', '.join(map(str, pending))}"
        after = replace(wait, met_since=None, text=text, next_at=min(times, default=None))
        world.put(unit, wait=_reported(step, unit, after))
        return None
    met_since = now if wait.met_since is None else wait.met_since
    if now < met_since + rule.delay:
        text = f"waits for its delay of {rule.delay:g} s"
        after = replace(wait, met_since=met_since, text=text, next_at=met_since + rule.delay)
        world.put(unit, wait=_reported(step, unit, after))
        return None
    if waived:
        step.log(f"{unit.key} starts all the same: {'; '.join(waived)}")
    world.put(unit, wait=None, released_at=now)
    return ""


def _reported(step: Reduction, unit: Process | Node, wait: Wait) -> Wait:
    """Warn of a unit that waits for long."""
    if unit.wait is None or step.now < wait.report_due:
        return wait
    text = f"{unit.name} has waited for {step.now - wait.since:.0f} s: it {wait.text}"
    step.log(text, is_shown_otherwise=True)
    return replace(wait, report_due=step.now + step.world.limits.report_interval)


def _deadline(world: World, wait: Wait, dependency: Dependency) -> float | None:
    """When a condition is given up; None while its unit waits itself, or without a limit."""
    if dependency.timeout == float("inf"):
        return None
    unit = world.find(dependency.unit)
    if unit is not None and unit.wait is not None:
        return None
    released = None if unit is None else unit.released_at
    since = wait.since if released is None else max(wait.since, released)
    return since + dependency.timeout


def condition_state(world: World, dependency: Dependency) -> str | None:
    condition, name = dependency.condition, dependency.unit
    if (condition, name, dependency.subject) in world.met:
        return ""
    if dependency.machine or not name:
        return None
    if condition is Condition.ACTIVE and (goal := world.goals.get(name)) is not None:
        if goal.state is ManagedState.ACTIVE:
            return ""
        if goal.state is ManagedState.FAILED:
            return goal.reason or "it failed"
    unit = world.find(name)
    match unit:
        case None:
            return "it is no longer in the configuration"
        case Node():
            state = _of_node(world, unit, is_enough_begun=condition is Condition.STARTED)
            return None if condition is Condition.ACTIVE and state == "" else state
        case Process():
            if condition in {Condition.STARTED, Condition.EXITED}:
                return _of_process(world, unit, condition)
            if condition is Condition.LOADED and unit.container is not None:
                return _of_all_nodes(world, unit)
            if not unit.is_at_rest:
                return None  # it may do it yet, and its last lines are still to be read
            return "it ended" if (state := _of_process(world, unit)) == "" else state


def _of_process(
    world: World, process: Process, condition: Condition = Condition.STARTED
) -> str | None:
    if process.phase is Phase.RUNNING:
        return "" if condition is Condition.STARTED else None
    if process.phase is Phase.GAVE_UP:
        return described("it gave up", process.reason)
    if process.phase is Phase.STOPPED and process.exit is not None and process.container is None:
        return "" if process.exit.is_ok else f"it ended: {process.exit.text}"
    is_leaving = process.phase in {Phase.STOPPED, Phase.STOPPING} and not process.is_requested
    if is_leaving or not is_wanted(world, process):
        return described("it is stopped", process.reason)
    return None


def _of_node(world: World, node: Node, *, is_enough_begun: bool = False) -> str | None:
    if node.state is NodeState.LOADED or (is_enough_begun and node.state is NodeState.LOADING):
        return ""
    if container := _of_process(world, world.processes[node.key.container]):
        return f"its container: {container}"
    returns = node.next_at is not None and not node.gives_up
    if node.state in _GONE and not returns and not node.is_requested:
        return described(_GONE[node.state], node.reason)
    return None


def unit_state(world: World, unit: Process | Node) -> str | None:
    """Evaluate whether a unit is up, a container with its nodes."""
    if isinstance(unit, Node):
        return _of_node(world, unit)
    return _of_process(world, unit) if unit.container is None else _of_all_nodes(world, unit)


def _of_all_nodes(world: World, container: Process) -> str | None:
    result = _of_process(world, container)
    for node in world.nodes_of(container.name):
        state = _of_node(world, node)
        if state and not result:
            return f"{node.key.name}: {state}"
        if state is None and result == "":
            result = None
    return result


def awaited_dependencies(world: World) -> tuple[Dependency, ...]:
    """Give the conditions of all units that wait now, met or not, each once."""
    found: dict[Dependency, None] = {}
    for key in sorted(world.waiting, key=world.places.__getitem__):
        unit = world.find(key)
        if unit is not None and unit.wait is not None and (rule := rule_of(world, unit)):
            found |= dict.fromkeys(rule.dependencies)
    return tuple(found)


def stopped_before(world: World) -> dict[str, frozenset[str]]:
    """Name for each process those that are stopped before it: they depend on it."""
    units = {name: tuple(map(str, world.keys.get(name, ()))) for name in world.processes}
    return DependencyGraph(world.config.start_rules, units).stopped_after()


_GOAL_REACHED: Final = frozenset({ManagedState.ACTIVE, ManagedState.FINALIZED, ManagedState.FAILED})


def has_arrived(world: World, unit: Process | Node) -> bool:
    """Whether a unit is up, or failed for good."""
    key = str(unit.key)
    if key in world.arrived:
        return True
    state = _of_process(world, unit) if isinstance(unit, Process) else _of_node(world, unit)
    goal = world.goals.get(key)
    if state == "" and goal is not None and goal.config.autostart is not None:
        is_enough = goal.config.autostart is Autostart.CONFIGURE
        return goal.state in _GOAL_REACHED or (is_enough and goal.state is ManagedState.INACTIVE)
    return state is not None


def pending_units(world: World) -> tuple[str, ...]:
    """Name the units that have neither been up nor failed for good; dismissed ones excluded."""
    units = [unit for key in world.places if (unit := world.find(key)) is not None]
    return tuple(
        str(unit.key)
        for unit in units
        if world.dismissed.isdisjoint({str(unit.key), unit.member}) and not has_arrived(world, unit)
    )


def absent_units(world: World, config: ReplayConfig) -> dict[str, str]:
    """Name what is declared, does not exist and is not going to be started, with the reason.

    A process that exited with status 0 is named only if an operator has stopped it, the nodes of a
    container that does not run are not, as they are loaded when it is started.
    """
    found: dict[str, str] = {}
    for name in config.parts:
        reason: str | None = "it was asked to end"
        match world.find(name):
            case Node(is_removed=False) as node:
                reason = None if node.key.container in found else _of_node(world, node)
            case Process(is_removed=False, next_config=None) as process:
                is_dismissed = name in world.dismissed
                reason = _of_process(world, process) or ("it was stopped" if is_dismissed else "")
        if reason:
            found[name] = reason
    return found


def nothing_is_left(world: World) -> bool:
    """Whether nothing runs, no start is pending, and no operator may request one."""
    if world.change is not None or any(name in world.dismissed for name in world.processes):
        return False
    return all(
        process.is_at_rest and not (is_wanted(world, process) and process.is_requested)
        for process in world.processes.values()
    )


def has_ended(world: World) -> bool:
    return world.is_stopping and all(
        process.phase in INACTIVE and process.is_at_rest for process in world.processes.values()
    )
