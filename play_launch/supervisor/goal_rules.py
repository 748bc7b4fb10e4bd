"""Rules of managed (lifecycle) nodes: they follow the process or node that they belong to."""

from __future__ import annotations

from typing import TYPE_CHECKING, assert_never

from play_launch.supervisor.conditions import find_unit
from play_launch.supervisor.events import NodeState
from play_launch.supervisor.goal_life import ManagedAction, ManagedInput, ManagedState
from play_launch.supervisor.goal_life import step as next_state
from play_launch.supervisor.inputs import Drive, Log, Release, Transit
from play_launch.supervisor.world import Node, Phase, Process

if TYPE_CHECKING:
    from play_launch.supervisor.inputs import GoalReported
    from play_launch.supervisor.reducer import Reduction
    from play_launch.supervisor.world import Goal, World


def settle(step: Reduction, name: str) -> None:
    """Begin a conversation with each new instance of a managed node, and end the old one."""
    world = step.world
    goal = world.goals[name]
    config = world.config.managed.get(name)
    instance = _instance(world, name) if config is not None else 0
    is_new = config is not None and config != goal.config
    if config is not None and goal.instance == instance and not is_new:
        return
    if config is not None:
        world.put(goal, config=config)
    if goal.instance and not instance:
        world.put(world.goals[name], instance=0)
        _apply(step, name, ManagedInput.GONE)
    elif instance:
        world.put(world.goals[name], instance=instance)
        _apply(step, name, ManagedInput.UP)
    if config is None:
        del world.goals[name]


def _instance(world: World, name: str) -> int:
    """Number the start or load that exists now; 0: none does."""
    match find_unit(world, name):
        case Process() as process:
            exists = process.phase is Phase.RUNNING and process.exit is None
            return process.attempt if exists else 0
        case Node() as node:
            return node.attempt if node.state is NodeState.LOADED else 0
    return 0


def reported(step: Reduction, said: GoalReported) -> None:
    goal = step.world.goals.get(said.unit)
    if goal is not None and goal.instance == said.instance:
        _apply(step, said.unit, said.said, said.reason)


def _apply(step: Reduction, name: str, said: ManagedInput, reason: str = "") -> None:
    goal: Goal = step.world.goals[name]
    state, actions = next_state(goal.state, said, goal.config.autostart)
    failure = reason if state is ManagedState.FAILED else ""
    step.world.put(goal, state=state, reason=failure)
    for action in actions:
        match action:
            case ManagedAction.ASK:
                step.effects.append(Drive(name, goal.instance))
            case ManagedAction.LEAVE:
                step.effects.append(Release(name))
            case ManagedAction.CONFIGURE | ManagedAction.ACTIVATE:
                step.effects.append(Transit(name, goal.instance, action))
            case ManagedAction.REPORT_FAILED:
                text = f"{goal.config.name} does not {goal.config.autostart}: {reason}"
                step.effects.append(Log(text, is_error=True, is_shown_otherwise=True))
            case _:
                assert_never(action)
