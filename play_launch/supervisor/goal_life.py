"""What becomes of a managed (lifecycle) node: state x input, beside the table of its own life.

The states of the node itself are those of ROS's design of managed nodes; this is what the
supervisor knows about them, and what it does to bring the node where ``autostart`` says. It starts
anew whenever the node does.
"""

from __future__ import annotations

from enum import StrEnum, auto
from typing import TYPE_CHECKING, Final, NamedTuple

from play_launch.config.policies import Autostart

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping


class ManagedState(StrEnum):
    """What is known about it."""

    ABSENT = "absent"
    """The node is not there."""
    ASKED = "asked"
    """It is there, and has not said yet in which state it is."""
    UNCONFIGURED = "unconfigured"
    CONFIGURING = "configuring"
    INACTIVE = "inactive"
    ACTIVATING = "activating"
    ACTIVE = "active"
    FINALIZED = "finalized"
    FAILED = "failed"
    """It did not get where it should; it stays where it is."""


class ManagedInput(StrEnum):
    """What can happen."""

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
    """What has to be done."""

    ASK = auto()
    """Ask for its state."""
    LEAVE = auto()
    """Talk to it no more."""
    CONFIGURE = auto()
    ACTIVATE = auto()
    REPORT_FAILED = auto()


UNDER_WAY: Final = frozenset(
    {ManagedState.ASKED, ManagedState.CONFIGURING, ManagedState.ACTIVATING}
)
"""States that do not last."""


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
"""Of one that is where it should be, or that nobody brings anywhere: others may move it."""

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
        # It says so before it begins; the answer follows.
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
    # Somebody may help it along by hand.
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
