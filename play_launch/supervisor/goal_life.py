"""Life of a managed (lifecycle) node: the table of state and input.

The states of the node itself are those of ROS's design of managed nodes. This is what the
supervisor knows of them, and what it does to reach the state that ``autostart`` requests. It begins
again with each start or load of the node.
"""

from __future__ import annotations

from enum import StrEnum, auto
from typing import TYPE_CHECKING, Final, NamedTuple

from play_launch.config.policies import Autostart

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping


class ManagedState(StrEnum):
    """State of a managed node, as far as it was reported."""

    ABSENT = "absent"
    """The node does not exist."""
    ASKED = "asked"
    """It exists, and has not reported its state."""
    UNCONFIGURED = "unconfigured"
    CONFIGURING = "configuring"
    INACTIVE = "inactive"
    ACTIVATING = "activating"
    ACTIVE = "active"
    FINALIZED = "finalized"
    FAILED = "failed"
    """A transition failed; the node stays in its state."""


class ManagedInput(StrEnum):
    """What can happen to a managed node."""

    UP = auto()
    """The node is loaded, or its process runs."""
    GONE = auto()
    IS_UNCONFIGURED = auto()
    IS_INACTIVE = auto()
    IS_ACTIVE = auto()
    IS_FINALIZED = auto()
    REFUSED = auto()
    """A transition failed."""
    OVERDUE = auto()
    """No answer within the limit."""


class ManagedAction(StrEnum):
    """What follows from an input besides the state."""

    ASK = auto()
    """Query its state."""
    LEAVE = auto()
    """End the conversation with it."""
    CONFIGURE = auto()
    ACTIVATE = auto()
    REPORT_FAILED = auto()


UNDER_WAY: Final = frozenset(
    {ManagedState.ASKED, ManagedState.CONFIGURING, ManagedState.ACTIVATING}
)
"""States that end with an answer or its timeout."""


class ManagedTransition(NamedTuple):
    """An entry of the table."""

    state: ManagedState
    actions: tuple[ManagedAction, ...] = ()


State, Said, Do = ManagedState, ManagedInput, ManagedAction
_Answers = dict[ManagedInput, tuple[ManagedState, *tuple[ManagedAction, ...]]]

_ASK: Final = (State.ASKED, Do.LEAVE, Do.ASK)
_GONE: Final = (State.ABSENT, Do.LEAVE)
_FAILED: Final = (State.FAILED, Do.REPORT_FAILED)
_IS: Final[_Answers] = {
    Said.IS_UNCONFIGURED: (State.UNCONFIGURED,),
    Said.IS_INACTIVE: (State.INACTIVE,),
    Said.IS_ACTIVE: (State.ACTIVE,),
    Said.IS_FINALIZED: (State.FINALIZED,),
}


def _row(
    state: ManagedState,
    answers: _Answers,
    ignores: Iterable[ManagedInput] = (),
) -> dict[ManagedInput, ManagedTransition]:
    row = {said: ManagedTransition(then, tuple(todo)) for said, (then, *todo) in answers.items()}
    return row | {said: ManagedTransition(state) for said in ignores}


_SETTLED: Final[_Answers] = {Said.UP: _ASK, Said.GONE: _GONE, **_IS}
"""Without a transition under way; other clients may change the state."""

TABLE: Final[Mapping[ManagedState, Mapping[ManagedInput, ManagedTransition]]] = {
    State.ABSENT: _row(
        State.ABSENT,
        {Said.UP: (State.ASKED, Do.ASK)},
        {Said.GONE, *_IS, Said.REFUSED, Said.OVERDUE},
    ),
    State.ASKED: _row(
        State.ASKED,
        {
            **_SETTLED,
            Said.IS_UNCONFIGURED: (State.CONFIGURING, Do.CONFIGURE),
            Said.IS_INACTIVE: (State.ACTIVATING, Do.ACTIVATE),
            Said.IS_FINALIZED: _FAILED,
            Said.REFUSED: _FAILED,
            Said.OVERDUE: _FAILED,
        },
    ),
    State.CONFIGURING: _row(
        State.CONFIGURING,
        {
            **_SETTLED,
            Said.IS_INACTIVE: (State.ACTIVATING, Do.ACTIVATE),
            Said.IS_FINALIZED: _FAILED,
            Said.REFUSED: _FAILED,
            Said.OVERDUE: _FAILED,
        },
        # The state before the transition, reported late.
        {Said.IS_UNCONFIGURED},
    ),
    State.ACTIVATING: _row(
        State.ACTIVATING,
        {
            **_SETTLED,
            Said.IS_UNCONFIGURED: _FAILED,
            Said.IS_FINALIZED: _FAILED,
            Said.REFUSED: _FAILED,
            Said.OVERDUE: _FAILED,
        },
        {Said.IS_INACTIVE},
    ),
    **{
        state: _row(state, _SETTLED, {Said.REFUSED, Said.OVERDUE})
        for state in (State.UNCONFIGURED, State.INACTIVE, State.ACTIVE, State.FINALIZED)
    },
    # An operator may request the transition by hand.
    State.FAILED: _row(
        State.FAILED,
        {
            Said.UP: _ASK,
            Said.GONE: _GONE,
            Said.IS_INACTIVE: (State.INACTIVE,),
            Said.IS_ACTIVE: (State.ACTIVE,),
        },
        {Said.IS_UNCONFIGURED, Said.IS_FINALIZED, Said.REFUSED, Said.OVERDUE},
    ),
}


def step(
    state: ManagedState, said: ManagedInput, goal: Autostart | None
) -> tuple[ManagedState, tuple[ManagedAction, ...]]:
    """Apply one input; without a goal the node is only watched."""
    then, actions = TABLE[state][said]
    if then is State.ACTIVATING and state is not then and goal is not Autostart.ACTIVATE:
        return State.INACTIVE, ()
    if goal is None:
        if then is State.CONFIGURING:
            return State.UNCONFIGURED, ()
        if then is State.FAILED:
            return _IS[said][0] if said in _IS else state, ()
    return then, actions
