"""The states of a composable node, what can happen to it, and what follows: the table itself.

:mod:`play_launch.core.lifecycle` applies it.
"""

from __future__ import annotations

from enum import StrEnum, auto
from typing import TYPE_CHECKING, Final, NamedTuple

from play_launch.core.events import NodeState

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from typing import TypeAlias

    _Answer: TypeAlias = tuple[NodeState, *tuple["NodeAction", ...]]
    """The state that follows, and what to do."""


class NodeInput(StrEnum):
    """What can happen to a node."""

    CONTAINER_READY = auto()
    CONTAINER_LOST = auto()
    UNLOAD_REQUESTED = auto()
    LOAD_REQUESTED = auto()
    """It is wanted, and its container is ready."""
    RELOAD_REQUESTED = auto()
    """It is wanted, as a new one; its container is ready."""
    WANTED = auto()
    """It is wanted when its container is ready."""
    REPLACED = auto()
    """It left as it was unloaded, and is wanted again by now."""
    RELOAD_DUE = auto()
    """The pause after a crash is over."""
    GIVEN_UP = auto()
    """No reload follows any more."""
    REFUSED = auto()
    """It is not sent to the container, which did not survive an earlier load of it, or what it
    depends on is not there."""
    SILENT = auto()
    """The container has not said anything for too long."""
    ACCEPTED = auto()
    REJECTED = auto()
    """The load was not taken up."""
    UNLOAD_REJECTED = auto()
    """The unload or cancel was not taken up."""
    LOADING = auto()
    LOADED = auto()
    LOAD_FAILED = auto()
    UNLOADED = auto()
    RELOAD_FAILED = auto()
    """A load that followed a crash was rejected or failed."""
    CRASHED = auto()
    STATUS_QUEUED = auto()
    """The load waits for others of the same container; nothing is wrong with that."""
    STATUS_CONSTRUCTING = auto()
    STATUS_LOADED = auto()
    STATUS_UNLOADING = auto()
    STATUS_UNKNOWN = auto()
    """The container was asked and does not know the attempt."""
    STATUS_UNKNOWN_AGAIN = auto()
    """The same for a load that had been sent anew already."""


class NodeAction(StrEnum):
    """What the actor has to do."""

    SEND_LOAD = auto()
    RESEND_LOAD = auto()
    SEND_QUERY = auto()
    SEND_CANCEL = auto()
    SEND_UNLOAD = auto()
    FOLLOW_UP = auto()
    """Decide what follows from a crash."""


class Transition(NamedTuple):
    """An entry of the table."""

    state: NodeState
    actions: tuple[NodeAction, ...] = ()


State, Said, Do = NodeState, NodeInput, NodeAction

WAITING: Final = frozenset({State.REQUESTED, State.LOADING, State.UNLOADING})
"""States in which the container owes an answer, so that silence means something."""

FROM_CONTAINER: Final = frozenset(
    {
        Said.ACCEPTED,
        Said.REJECTED,
        Said.LOADING,
        Said.LOADED,
        Said.LOAD_FAILED,
        Said.RELOAD_FAILED,
        Said.UNLOADED,
        Said.CRASHED,
        Said.STATUS_QUEUED,
        Said.STATUS_CONSTRUCTING,
        Said.STATUS_LOADED,
        Said.STATUS_UNLOADING,
        Said.STATUS_UNKNOWN,
        Said.STATUS_UNKNOWN_AGAIN,
    }
)
"""Words about one attempt; they count only for that attempt."""


def _row(
    state: NodeState,
    answers: Mapping[NodeInput, _Answer],
    ignores: Iterable[NodeInput],
) -> dict[NodeInput, Transition]:
    row = {said: Transition(then, tuple(todo)) for said, (then, *todo) in answers.items()}
    for said in ignores:
        if said in row:
            msg = f"{state}: {said} is both answered and ignored"
            raise ValueError(msg)
        row[said] = Transition(state)
    return row


_NEW_LOAD: Final = (State.REQUESTED, Do.SEND_LOAD)
_CRASH: Final = (State.CRASHED, Do.FOLLOW_UP)
_FAILED: Final = (State.LOAD_FAILED,)
_FAILED_AGAIN: Final = (State.LOAD_FAILED, Do.FOLLOW_UP)
_UNLOADED: Final = (State.UNLOADED,)
_LOST: Final = (State.LOST,)
_TIMERS: Final = (Said.SILENT, Said.RELOAD_DUE, Said.GIVEN_UP)
_ENDS_OF_A_LOAD: Final[Mapping[NodeInput, _Answer]] = {
    Said.LOADED: (State.LOADED,),
    Said.LOAD_FAILED: _FAILED,
    Said.RELOAD_FAILED: _FAILED_AGAIN,
    Said.UNLOADED: _UNLOADED,
    Said.CRASHED: _CRASH,
    Said.CONTAINER_LOST: _LOST,
    Said.STATUS_CONSTRUCTING: (State.LOADING,),
    Said.STATUS_LOADED: (State.LOADED,),
    Said.STATUS_UNLOADING: (State.UNLOADING,),
    Said.STATUS_UNKNOWN: (State.REQUESTED, Do.RESEND_LOAD),
    Said.STATUS_UNKNOWN_AGAIN: (State.LOAD_FAILED,),
}
"""What follows from an answer to a load, whether the container has accepted it yet or not: the
answers in between may have been dropped."""

TABLE: Final[Mapping[NodeState, Mapping[NodeInput, Transition]]] = {
    State.PENDING: _row(
        State.PENDING,
        {
            Said.CONTAINER_READY: _NEW_LOAD,
            Said.REFUSED: _FAILED,
            Said.UNLOAD_REQUESTED: _UNLOADED,
        },
        {
            Said.LOAD_REQUESTED,
            Said.RELOAD_REQUESTED,
            Said.WANTED,
            Said.REPLACED,
            Said.CONTAINER_LOST,
            Said.UNLOAD_REJECTED,
            *_TIMERS,
            *FROM_CONTAINER,
        },
    ),
    State.REQUESTED: _row(
        State.REQUESTED,
        {
            **_ENDS_OF_A_LOAD,
            Said.RELOAD_REQUESTED: (State.UNLOADING,),
            Said.ACCEPTED: (State.LOADING,),
            Said.LOADING: (State.LOADING,),
            Said.REJECTED: _FAILED,
            Said.SILENT: (State.REQUESTED, Do.SEND_QUERY),
            # Without a unique_id there is nothing to cancel yet; ACCEPTED brings it.
            Said.UNLOAD_REQUESTED: (State.UNLOADING,),
        },
        {
            Said.LOAD_REQUESTED,
            Said.WANTED,
            Said.REPLACED,
            Said.REFUSED,
            Said.CONTAINER_READY,
            Said.RELOAD_DUE,
            Said.GIVEN_UP,
            Said.UNLOAD_REJECTED,
            Said.STATUS_QUEUED,
        },
    ),
    State.LOADING: _row(
        State.LOADING,
        {
            **_ENDS_OF_A_LOAD,
            Said.RELOAD_REQUESTED: (State.UNLOADING, Do.SEND_CANCEL),
            Said.SILENT: (State.LOADING, Do.SEND_QUERY),
            Said.UNLOAD_REQUESTED: (State.UNLOADING, Do.SEND_CANCEL),
            # It was accepted before: the two contradict each other, so ask.
            Said.REJECTED: (State.LOADING, Do.SEND_QUERY),
        },
        {
            Said.LOAD_REQUESTED,
            Said.WANTED,
            Said.REPLACED,
            Said.REFUSED,
            Said.CONTAINER_READY,
            Said.RELOAD_DUE,
            Said.GIVEN_UP,
            Said.UNLOAD_REJECTED,
            Said.ACCEPTED,
            Said.LOADING,
            Said.STATUS_QUEUED,
        },
    ),
    State.LOADED: _row(
        State.LOADED,
        {
            Said.RELOAD_REQUESTED: (State.UNLOADING, Do.SEND_UNLOAD),
            Said.UNLOADED: _UNLOADED,
            Said.CRASHED: _CRASH,
            Said.CONTAINER_LOST: _LOST,
            Said.UNLOAD_REQUESTED: (State.UNLOADING, Do.SEND_UNLOAD),
            Said.STATUS_UNLOADING: (State.UNLOADING,),
            # An attempt that the container does not know after it was accepted never comes back.
            Said.STATUS_UNKNOWN: (State.LOST,),
            Said.STATUS_UNKNOWN_AGAIN: (State.LOST,),
            Said.REJECTED: (State.LOADED, Do.SEND_QUERY),
            Said.LOAD_FAILED: (State.LOADED, Do.SEND_QUERY),
            Said.RELOAD_FAILED: (State.LOADED, Do.SEND_QUERY),
        },
        {
            Said.LOAD_REQUESTED,
            Said.WANTED,
            Said.REPLACED,
            Said.REFUSED,
            Said.CONTAINER_READY,
            *_TIMERS,
            Said.UNLOAD_REJECTED,
            Said.ACCEPTED,
            Said.LOADING,
            Said.LOADED,
            Said.STATUS_LOADED,
            Said.STATUS_CONSTRUCTING,
            Said.STATUS_QUEUED,
        },
    ),
    State.UNLOADING: _row(
        State.UNLOADING,
        {
            Said.REPLACED: _NEW_LOAD,
            Said.ACCEPTED: (State.UNLOADING, Do.SEND_CANCEL),
            Said.REJECTED: _UNLOADED,
            # The constructor was quicker than the cancellation.
            Said.LOADED: (State.UNLOADING, Do.SEND_UNLOAD),
            Said.LOAD_FAILED: _UNLOADED,
            Said.RELOAD_FAILED: _UNLOADED,
            Said.UNLOADED: _UNLOADED,
            # Nobody wants it any more, so it is not brought back.
            Said.CRASHED: (State.CRASHED,),
            Said.CONTAINER_LOST: _UNLOADED,
            Said.UNLOAD_REJECTED: (State.UNLOADING, Do.SEND_QUERY),
            Said.SILENT: (State.UNLOADING, Do.SEND_QUERY),
            Said.STATUS_CONSTRUCTING: (State.UNLOADING, Do.SEND_CANCEL),
            Said.STATUS_LOADED: (State.UNLOADING, Do.SEND_UNLOAD),
            Said.STATUS_UNKNOWN: _UNLOADED,
            Said.STATUS_UNKNOWN_AGAIN: _UNLOADED,
        },
        {
            Said.LOAD_REQUESTED,
            Said.RELOAD_REQUESTED,
            Said.WANTED,
            Said.REFUSED,
            Said.CONTAINER_READY,
            Said.RELOAD_DUE,
            Said.GIVEN_UP,
            Said.LOADING,
            Said.UNLOAD_REQUESTED,
            Said.STATUS_UNLOADING,
            Said.STATUS_QUEUED,
        },
    ),
    State.LOAD_FAILED: _row(
        State.LOAD_FAILED,
        # A new container process is a new chance.
        {
            Said.LOAD_REQUESTED: _NEW_LOAD,
            Said.RELOAD_REQUESTED: _NEW_LOAD,
            Said.CONTAINER_READY: _NEW_LOAD,
            Said.RELOAD_DUE: _NEW_LOAD,
            Said.GIVEN_UP: (State.GAVE_UP,),
            Said.UNLOAD_REQUESTED: _UNLOADED,
        },
        {
            Said.WANTED,
            Said.REPLACED,
            Said.REFUSED,
            Said.CONTAINER_LOST,
            Said.UNLOAD_REJECTED,
            Said.SILENT,
            *FROM_CONTAINER,
        },
    ),
    State.UNLOADED: _row(
        State.UNLOADED,
        # A new container process is brought up as declared: a container that was ended from
        # outside says that it unloads its nodes, too.
        {
            Said.LOAD_REQUESTED: _NEW_LOAD,
            Said.RELOAD_REQUESTED: _NEW_LOAD,
            Said.CONTAINER_READY: _NEW_LOAD,
        },
        {
            Said.WANTED,
            Said.REPLACED,
            Said.REFUSED,
            Said.CONTAINER_LOST,
            Said.UNLOAD_REQUESTED,
            Said.UNLOAD_REJECTED,
            *_TIMERS,
            *FROM_CONTAINER,
        },
    ),
    State.CRASHED: _row(
        State.CRASHED,
        {
            Said.LOAD_REQUESTED: _NEW_LOAD,
            Said.RELOAD_REQUESTED: _NEW_LOAD,
            Said.RELOAD_DUE: _NEW_LOAD,
            Said.GIVEN_UP: (State.GAVE_UP,),
            Said.CONTAINER_LOST: _LOST,
            Said.UNLOAD_REQUESTED: _UNLOADED,
        },
        {
            Said.WANTED,
            Said.REPLACED,
            Said.REFUSED,
            Said.CONTAINER_READY,
            Said.SILENT,
            Said.UNLOAD_REJECTED,
            *FROM_CONTAINER,
        },
    ),
    State.GAVE_UP: _row(
        State.GAVE_UP,
        {
            Said.LOAD_REQUESTED: _NEW_LOAD,
            Said.RELOAD_REQUESTED: _NEW_LOAD,
            Said.UNLOAD_REQUESTED: _UNLOADED,
        },
        # It does not come back with its container either: it may be what brought that down.
        {
            Said.WANTED,
            Said.REPLACED,
            Said.REFUSED,
            Said.CONTAINER_READY,
            Said.CONTAINER_LOST,
            Said.UNLOAD_REJECTED,
            *_TIMERS,
            *FROM_CONTAINER,
        },
    ),
    State.LOST: _row(
        State.LOST,
        {
            Said.LOAD_REQUESTED: _NEW_LOAD,
            Said.RELOAD_REQUESTED: _NEW_LOAD,
            Said.CONTAINER_READY: _NEW_LOAD,
            Said.REFUSED: _FAILED,
            Said.UNLOAD_REQUESTED: _UNLOADED,
        },
        {
            Said.WANTED,
            Said.REPLACED,
            Said.CONTAINER_LOST,
            Said.UNLOAD_REJECTED,
            *_TIMERS,
            *FROM_CONTAINER,
        },
    ),
}
