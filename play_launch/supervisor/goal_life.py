"""Life of a managed (lifecycle) node: the table of state and input.

The states of the node itself are those of ROS's design of managed nodes. This is what the
supervisor knows of them, and what it does to reach the state that ``autostart`` requests. It begins
again with each start or load of the node.
"""

from __future__ import annotations

from enum import StrEnum, auto
from typing import TYPE_CHECKING, Final, NamedTuple

from play_launch.config.model import Autostart

if TYPE_CHECKING:
    from collections.abc import Mapping


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


_SETTLED: Final[_Answers] = {Said.UP: _ASK, Said.GONE: _GONE, **_IS}
"""Without a transition under way; other clients may change the state."""
_WAITING: Final[_Answers] = {
    **_SETTLED,
    Said.IS_FINALIZED: _FAILED,
    Said.REFUSED: _FAILED,
    Said.OVERDUE: _FAILED,
}
_CONFIGURE: Final = (State.CONFIGURING, Do.CONFIGURE)
_ACTIVATE: Final = (State.ACTIVATING, Do.ACTIVATE)

_TABLE: Final[Mapping[ManagedState, _Answers]] = {
    State.ABSENT: {Said.UP: (State.ASKED, Do.ASK)},
    State.ASKED: {**_WAITING, Said.IS_UNCONFIGURED: _CONFIGURE, Said.IS_INACTIVE: _ACTIVATE},
    # The state before the transition may be reported late.
    State.CONFIGURING: {
        **_WAITING,
        Said.IS_UNCONFIGURED: (State.CONFIGURING,),
        Said.IS_INACTIVE: _ACTIVATE,
    },
    State.ACTIVATING: {
        **_WAITING,
        Said.IS_UNCONFIGURED: _FAILED,
        Said.IS_INACTIVE: (State.ACTIVATING,),
    },
    **dict.fromkeys((State.UNCONFIGURED, State.INACTIVE, State.ACTIVE, State.FINALIZED), _SETTLED),
    # An operator may request the transition by hand.
    State.FAILED: {
        Said.UP: _ASK,
        Said.GONE: _GONE,
        Said.IS_INACTIVE: (State.INACTIVE,),
        Said.IS_ACTIVE: (State.ACTIVE,),
    },
}
TABLE: Final = {
    state: {
        said: ManagedTransition(then, tuple(todo))
        for said in ManagedInput
        for then, *todo in (answers.get(said, (state,)),)
    }
    for state, answers in _TABLE.items()
}
"""An input without an answer leaves the state as it is."""


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
