"""Managed (lifecycle) nodes: they follow the process or composable node that they belong to.

The states are those of ROS's design of managed nodes, and what the supervisor knows of them. It
brings a node to the state that ``autostart`` requests, again with each start or load of it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from play_launch.config.model import Autostart
from play_launch.supervisor.events import ManagedState, NodeState
from play_launch.supervisor.inputs import Drive, Log, ManagedInput
from play_launch.supervisor.transitions import table
from play_launch.supervisor.view import UNDER_WAY
from play_launch.supervisor.world import Node

if TYPE_CHECKING:
    from play_launch.supervisor.inputs import GoalReported
    from play_launch.supervisor.reducer import Reduction
    from play_launch.supervisor.world import Goal, World


State, Said = ManagedState, ManagedInput

_IS: Final = {
    Said.IS_UNCONFIGURED: State.UNCONFIGURED,
    Said.IS_INACTIVE: State.INACTIVE,
    Said.IS_ACTIVE: State.ACTIVE,
    Said.IS_FINALIZED: State.FINALIZED,
}
_IDLE: Final = frozenset(_IS.values())
"""States without a transition under way; other clients may change them."""
_EXISTS: Final = UNDER_WAY | _IDLE | {State.FAILED}
_TALKED_ABOUT: Final = UNDER_WAY | {State.ABSENT}

TABLE: Final = table(
    State,
    Said,
    (_EXISTS | {State.ABSENT}, Said.UP, State.ASKED),
    (_EXISTS, Said.GONE, State.ABSENT),
    (State.ABSENT, {*_IS, Said.GONE, Said.REFUSED, Said.OVERDUE}, None),
    # The state before the transition may be reported late.
    ({State.ASKED, State.CONFIGURING}, Said.IS_UNCONFIGURED, State.CONFIGURING),
    (UNDER_WAY, Said.IS_INACTIVE, State.ACTIVATING),
    (State.ACTIVATING, Said.IS_UNCONFIGURED, State.FAILED),
    (UNDER_WAY, Said.IS_ACTIVE, State.ACTIVE),
    (UNDER_WAY, {Said.IS_FINALIZED, Said.REFUSED, Said.OVERDUE}, State.FAILED),
    *((_IDLE, said, state) for said, state in _IS.items()),
    (_IDLE, {Said.REFUSED, Said.OVERDUE}, None),
    # An operator may request the transition by hand.
    (State.FAILED, Said.IS_INACTIVE, State.INACTIVE),
    (State.FAILED, Said.IS_ACTIVE, State.ACTIVE),
    (State.FAILED, {Said.IS_UNCONFIGURED, Said.IS_FINALIZED}, None),
    (State.FAILED, {Said.REFUSED, Said.OVERDUE}, None),
)
"""The state that follows; None: it stays as it is."""


def next_state(state: ManagedState, said: ManagedInput, goal: Autostart | None) -> ManagedState:
    """Apply one input; without a goal the node is only watched."""
    then = TABLE[state][said] or state
    if then is State.ACTIVATING and goal is not Autostart.ACTIVATE:
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
    goal, config = world.goals[name], world.config.managed.get(name)
    instance = 0 if config is None else _instance(world, name)
    if (config, instance) == (goal.config, goal.instance):
        return
    world.put(goal, config=config or goal.config, instance=instance)
    _apply(step, name, ManagedInput.UP if instance else ManagedInput.GONE)
    if config is None:
        world.forget(world.goals[name])


def _instance(world: World, name: str) -> int:
    """Number the start or load that exists now; 0: none does."""
    unit = world.find(name)
    if isinstance(unit, Node):
        return unit.attempt if unit.state is NodeState.LOADED else 0
    return unit.attempt if unit is not None and unit.runs else 0


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
    if state in _TALKED_ABOUT:
        step.effects.append(Drive(name, goal.instance, state))
    elif state is ManagedState.FAILED:
        text = f"{goal.config.name} does not {goal.config.autostart}: {reason}"
        step.effects.append(Log(text, is_error=True, is_shown_otherwise=True))
