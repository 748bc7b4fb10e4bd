"""Life of a composable node: the table of state and fact.

The container owns the node; this is the supervisor's mirror of what it reported.

* Silence is a question: no answer within the loading timeout leads to a query, never to a guess.
* No late report about an attempt that ended brings a node back.
* A node is never loaded twice: a load is sent again only after the container reported that it does
  not know the attempt, and only once, under a new attempt.
"""

from __future__ import annotations

from enum import StrEnum, auto
from typing import TYPE_CHECKING, Final, NamedTuple, TypeAlias

from play_launch.supervisor.events import NodeState as State

if TYPE_CHECKING:
    from collections.abc import Mapping


class NodeFact(StrEnum):
    """What can happen to a node."""

    LOAD = auto()
    """It is to be loaded, and its container takes loads."""
    LEAVE = auto()
    """It is not wanted, or to be replaced."""
    REFUSED = auto()
    """It is not sent to the container, which did not survive an earlier load of it, or what it
    depends on does not exist."""
    GIVEN_UP = auto()
    CONTAINER_LOST = auto()
    SILENT = auto()
    """The container has not reported anything for too long."""
    ACCEPTED = auto()
    REJECTED = auto()
    UNLOAD_REJECTED = auto()
    LOADING = auto()
    LOADED = auto()
    LOAD_FAILED = auto()
    RELOAD_FAILED = auto()
    """A load that followed a crash was rejected or failed."""
    UNLOADED = auto()
    CRASHED = auto()
    STATUS_QUEUED = auto()
    """The load waits for others of the same container."""
    STATUS_CONSTRUCTING = auto()
    STATUS_LOADED = auto()
    STATUS_UNLOADING = auto()
    STATUS_UNKNOWN = auto()
    """The container was queried and does not know the attempt."""
    STATUS_UNKNOWN_AGAIN = auto()
    """The same for a load that was sent a second time."""


class NodeAction(StrEnum):
    """What follows from a fact besides the state."""

    LOAD = auto()
    LOAD_AGAIN = auto()
    QUERY = auto()
    CANCEL = auto()
    UNLOAD = auto()
    RESTART = auto()
    """Decide whether it is loaded again."""


class NodeCell(NamedTuple):
    """An entry of the table."""

    state: State
    actions: tuple[NodeAction, ...] = ()


Fact, Do = NodeFact, NodeAction
_Answers: TypeAlias = "Mapping[NodeFact, tuple[State, *tuple[NodeAction, ...]]]"

AWAITED: Final = frozenset({State.REQUESTED, State.LOADING, State.UNLOADING})
"""States in which the container owes an answer."""
LOADING: Final = frozenset({State.REQUESTED, State.LOADING})
IDLE: Final = frozenset(
    {
        State.PENDING,
        State.LOAD_FAILED,
        State.UNLOADED,
        State.CRASHED,
        State.GAVE_UP,
        State.LOST,
    }
)
"""States in which the container does not have it."""

STATUS: Final = frozenset(
    {
        Fact.STATUS_QUEUED,
        Fact.STATUS_CONSTRUCTING,
        Fact.STATUS_LOADED,
        Fact.STATUS_UNLOADING,
        Fact.STATUS_UNKNOWN,
        Fact.STATUS_UNKNOWN_AGAIN,
    }
)
REPORTED: Final = frozenset(
    {
        Fact.ACCEPTED,
        Fact.REJECTED,
        Fact.LOADING,
        Fact.LOADED,
        Fact.LOAD_FAILED,
        Fact.RELOAD_FAILED,
        Fact.UNLOADED,
        Fact.CRASHED,
        *STATUS,
    }
)
"""Facts about one attempt; they count only for that attempt."""


def _row(state: State, answers: _Answers) -> dict[NodeFact, NodeCell]:
    """Complete a row: a fact without an answer leaves the state as it is."""
    row = {fact: NodeCell(then, tuple(actions)) for fact, (then, *actions) in answers.items()}
    return dict.fromkeys(NodeFact, NodeCell(state)) | row


_LOAD: Final = (State.REQUESTED, Do.LOAD)
_END_OF_LOAD: Final[_Answers] = {
    Fact.LOADED: (State.LOADED,),
    Fact.LOAD_FAILED: (State.LOAD_FAILED,),
    Fact.RELOAD_FAILED: (State.LOAD_FAILED, Do.RESTART),
    Fact.UNLOADED: (State.UNLOADED,),
    Fact.CRASHED: (State.CRASHED, Do.RESTART),
    Fact.CONTAINER_LOST: (State.LOST,),
    Fact.STATUS_CONSTRUCTING: (State.LOADING,),
    Fact.STATUS_LOADED: (State.LOADED,),
    Fact.STATUS_UNLOADING: (State.UNLOADING,),
    Fact.STATUS_UNKNOWN: (State.REQUESTED, Do.LOAD_AGAIN),
    Fact.STATUS_UNKNOWN_AGAIN: (State.LOAD_FAILED,),
}
"""Whether the load was accepted or not: the reports in between may have been dropped."""

_TABLE: Final[Mapping[State, _Answers]] = {
    State.PENDING: {
        Fact.LOAD: _LOAD,
        Fact.REFUSED: (State.LOAD_FAILED,),
        Fact.LEAVE: (State.UNLOADED,),
    },
    State.REQUESTED: {
        **_END_OF_LOAD,
        Fact.ACCEPTED: (State.LOADING,),
        Fact.LOADING: (State.LOADING,),
        Fact.REJECTED: (State.LOAD_FAILED,),
        Fact.SILENT: (State.REQUESTED, Do.QUERY),
        # Without a unique_id there is nothing to cancel yet; ACCEPTED brings it.
        Fact.LEAVE: (State.UNLOADING,),
    },
    State.LOADING: {
        **_END_OF_LOAD,
        Fact.LEAVE: (State.UNLOADING, Do.CANCEL),
        Fact.SILENT: (State.LOADING, Do.QUERY),
        # It was accepted before: the two contradict each other.
        Fact.REJECTED: (State.LOADING, Do.QUERY),
    },
    State.LOADED: {
        Fact.LEAVE: (State.UNLOADING, Do.UNLOAD),
        Fact.UNLOADED: (State.UNLOADED,),
        Fact.CRASHED: (State.CRASHED, Do.RESTART),
        Fact.CONTAINER_LOST: (State.LOST,),
        Fact.STATUS_UNLOADING: (State.UNLOADING,),
        # An attempt that the container does not know after it was accepted never returns.
        Fact.STATUS_UNKNOWN: (State.LOST,),
        Fact.STATUS_UNKNOWN_AGAIN: (State.LOST,),
        Fact.REJECTED: (State.LOADED, Do.QUERY),
        Fact.LOAD_FAILED: (State.LOADED, Do.QUERY),
        Fact.RELOAD_FAILED: (State.LOADED, Do.QUERY),
    },
    State.UNLOADING: {
        Fact.ACCEPTED: (State.UNLOADING, Do.CANCEL),
        Fact.REJECTED: (State.UNLOADED,),
        # The constructor was quicker than the cancellation.
        Fact.LOADED: (State.UNLOADING, Do.UNLOAD),
        Fact.LOAD_FAILED: (State.UNLOADED,),
        Fact.RELOAD_FAILED: (State.UNLOADED,),
        Fact.UNLOADED: (State.UNLOADED,),
        Fact.CRASHED: (State.CRASHED,),
        Fact.CONTAINER_LOST: (State.UNLOADED,),
        Fact.UNLOAD_REJECTED: (State.UNLOADING, Do.QUERY),
        Fact.SILENT: (State.UNLOADING, Do.QUERY),
        # Whether the load was accepted may not have been known before.
        Fact.STATUS_QUEUED: (State.UNLOADING, Do.CANCEL),
        Fact.STATUS_CONSTRUCTING: (State.UNLOADING, Do.CANCEL),
        Fact.STATUS_LOADED: (State.UNLOADING, Do.UNLOAD),
        Fact.STATUS_UNKNOWN: (State.UNLOADED,),
        Fact.STATUS_UNKNOWN_AGAIN: (State.UNLOADED,),
    },
    State.LOAD_FAILED: {
        Fact.LOAD: _LOAD,
        Fact.GIVEN_UP: (State.GAVE_UP,),
        Fact.LEAVE: (State.UNLOADED,),
    },
    State.UNLOADED: {Fact.LOAD: _LOAD},
    State.CRASHED: {
        Fact.LOAD: _LOAD,
        Fact.GIVEN_UP: (State.GAVE_UP,),
        Fact.CONTAINER_LOST: (State.LOST,),
        Fact.LEAVE: (State.UNLOADED,),
    },
    # It does not return with its container: it may be what brought that down.
    State.GAVE_UP: {Fact.LOAD: _LOAD, Fact.LEAVE: (State.UNLOADED,)},
    State.LOST: {
        Fact.LOAD: _LOAD,
        Fact.REFUSED: (State.LOAD_FAILED,),
        Fact.LEAVE: (State.UNLOADED,),
    },
}
TABLE: Final = {state: _row(state, answers) for state, answers in _TABLE.items()}
