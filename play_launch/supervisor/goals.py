"""Managed (lifecycle) nodes: they follow the process or composable node that they belong to.

The states are those of ROS's design of managed nodes, and what the supervisor knows of them. It
brings a node to the state that ``autostart`` requests, again with each start or load of it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from play_launch.config.model import Autostart
from play_launch.supervisor.conditions import find_unit
from play_launch.supervisor.events import ManagedState, NodeState
from play_launch.supervisor.inputs import Drive, Log, ManagedInput, Release, Transit
from play_launch.supervisor.world import Node, Phase, Process

if TYPE_CHECKING:
    from collections.abc import Mapping

    from play_launch.supervisor.inputs import GoalReported
    from play_launch.supervisor.reducer import Reduction
    from play_launch.supervisor.world import Goal, World


State, Said = ManagedState, ManagedInput
_Answers = dict[ManagedInput, ManagedState]

_IS: Final[_Answers] = {
    Said.IS_UNCONFIGURED: State.UNCONFIGURED,
    Said.IS_INACTIVE: State.INACTIVE,
    Said.IS_ACTIVE: State.ACTIVE,
    Said.IS_FINALIZED: State.FINALIZED,
}
_EXISTS: Final[_Answers] = {Said.UP: State.ASKED, Said.GONE: State.ABSENT}
_SETTLED: Final[_Answers] = {**_EXISTS, **_IS}
"""Without a transition under way; other clients may change the state."""
_WAITING: Final[_Answers] = {
    **_SETTLED,
    Said.IS_FINALIZED: State.FAILED,
    Said.REFUSED: State.FAILED,
    Said.OVERDUE: State.FAILED,
}

TABLE: Final[Mapping[ManagedState, _Answers]] = {
    State.ABSENT: {Said.UP: State.ASKED},
    State.ASKED: {
        **_WAITING,
        Said.IS_UNCONFIGURED: State.CONFIGURING,
        Said.IS_INACTIVE: State.ACTIVATING,
    },
    # The state before the transition may be reported late.
    State.CONFIGURING: {
        **_WAITING,
        Said.IS_UNCONFIGURED: State.CONFIGURING,
        Said.IS_INACTIVE: State.ACTIVATING,
    },
    State.ACTIVATING: {
        **_WAITING,
        Said.IS_UNCONFIGURED: State.FAILED,
        Said.IS_INACTIVE: State.ACTIVATING,
    },
    **dict.fromkeys((State.UNCONFIGURED, State.INACTIVE, State.ACTIVE, State.FINALIZED), _SETTLED),
    # An operator may request the transition by hand.
    State.FAILED: {
        **_EXISTS,
        Said.IS_INACTIVE: State.INACTIVE,
        Said.IS_ACTIVE: State.ACTIVE,
    },
}
"""The state that follows; an input that is not in a row changes nothing."""


def next_state(state: ManagedState, said: ManagedInput, goal: Autostart | None) -> ManagedState:
    """Apply one input; without a goal the node is only watched."""
    then = TABLE[state].get(said, state)
    if then is State.ACTIVATING and state is not then and goal is not Autostart.ACTIVATE:
        return State.INACTIVE
    if goal is None:
        if then is State.CONFIGURING:
            return State.UNCONFIGURED
        if then is State.FAILED:
            return _IS.get(said, state)
    return then


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
    state = next_state(goal.state, said, goal.config.autostart)
    failure = reason if state is ManagedState.FAILED else ""
    step.world.put(goal, state=state, reason=failure)
    if state is goal.state and said is not ManagedInput.UP:
        return
    match state:
        case ManagedState.ABSENT:
            step.effects.append(Release(name))
        case ManagedState.ASKED:
            step.effects.append(Drive(name, goal.instance))
        case ManagedState.CONFIGURING | ManagedState.ACTIVATING:
            step.effects.append(Transit(name, goal.instance, state))
        case ManagedState.FAILED:
            text = f"{goal.config.name} does not {goal.config.autostart}: {reason}"
            step.effects.append(Log(text, is_error=True, is_shown_otherwise=True))
        case _:
            pass
