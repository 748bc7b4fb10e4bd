"""Lives of containers, processes and composable nodes: the tables of state and fact.

The container owns its nodes; their table is the supervisor's mirror of what it reported:

* Silence is a question: no answer within the loading timeout leads to a query, never to a guess.
* No late report about an attempt that ended brings a node back.
* A node is never loaded twice: a load is sent again only after the container reported that it does
  not know the attempt, and only once, under a new attempt.
"""

from __future__ import annotations

from enum import StrEnum, auto
from typing import TYPE_CHECKING, Final, TypeAlias, TypeVar

from play_launch.supervisor.events import NodeState as State
from play_launch.supervisor.world import Phase

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

_State = TypeVar("_State")
_Fact = TypeVar("_Fact")
_Action = TypeVar("_Action")


def complete(
    facts: Iterable[_Fact],
    table: Mapping[_State, Mapping[_Fact, tuple[_State, *tuple[_Action, ...]]]],
) -> dict[_State, dict[_Fact, tuple[_State, tuple[_Action, ...]]]]:
    """Complete a table: a fact without an answer leaves the state as it is."""
    return {
        state: {
            fact: (then, tuple(actions))
            for fact in facts
            for then, *actions in (row.get(fact, (state,)),)
        }
        for state, row in table.items()
    }


# Containers and ordinary processes.


class Fact(StrEnum):
    """What can happen to a process."""

    START = auto()
    """A start was requested that has not been attempted."""
    TURN = auto()
    """Its conditions are met, and nothing is left of its last process."""
    STARTED = auto()
    READY = auto()
    """A container said hello; another process runs."""
    FAULTY = auto()
    """It has to be killed."""
    STOP = auto()
    EXITED_RESTART = auto()
    """It exited or could not be started, and is restarted."""
    EXITED_GIVE_UP = auto()
    """The same, and it is not restarted."""
    EXITED_DONE = auto()
    """It exited, which is no failure."""
    IMPOSSIBLE = auto()
    """A condition of its start cannot be met."""
    STUCK = auto()
    """Not even SIGKILL ended it within its limit."""
    RESTART_DUE = auto()
    FAILED = auto()
    """The supervisor's own code for it failed."""


class Action(StrEnum):
    """What follows from a fact besides the phase."""

    SPAWN = auto()
    CANCEL_SPAWN = auto()
    KILL = auto()
    STOP = auto()
    LOSE = auto()
    """Its composable nodes are lost."""


_Row: TypeAlias = "Mapping[Fact, tuple[Phase, *tuple[Action, ...]]]"

_EXITS: Final = (Fact.EXITED_RESTART, Fact.EXITED_GIVE_UP, Fact.EXITED_DONE)
_QUEUE: Final = (Phase.QUEUED,)
_KILL: Final = (Phase.KILLING, Action.KILL)
_STOP: Final = (Phase.STOPPING, Action.STOP)
_LIVES: Final[_Row] = {
    Fact.EXITED_RESTART: (Phase.BACKOFF, Action.LOSE),
    Fact.EXITED_GIVE_UP: (Phase.GAVE_UP, Action.LOSE),
    Fact.EXITED_DONE: (Phase.STOPPED, Action.LOSE),
    Fact.STOP: _STOP,
    # What still runs of it is stopped in order.
    Fact.FAILED: (Phase.GAVE_UP, Action.LOSE, Action.STOP),
}

_PROCESS: Final[Mapping[Phase, _Row]] = {
    Phase.STOPPED: {
        Fact.START: _QUEUE,
        Fact.FAILED: (Phase.GAVE_UP,),
        Fact.STARTED: (Phase.STOPPED, Action.STOP),
    },
    Phase.QUEUED: {
        Fact.TURN: (Phase.SPAWNING, Action.SPAWN),
        Fact.IMPOSSIBLE: (Phase.GAVE_UP,),
        Fact.STOP: (Phase.STOPPED,),
        Fact.FAILED: (Phase.GAVE_UP,),
        # A process of an earlier start, which failed meanwhile, is not left running.
        Fact.STARTED: (Phase.QUEUED, Action.STOP),
    },
    Phase.SPAWNING: {
        Fact.STARTED: (Phase.STARTING,),
        Fact.EXITED_RESTART: (Phase.BACKOFF,),
        Fact.EXITED_GIVE_UP: (Phase.GAVE_UP,),
        Fact.EXITED_DONE: (Phase.STOPPED,),
        # One that has just got a pid is stopped then.
        Fact.STOP: (Phase.STOPPING, Action.CANCEL_SPAWN),
        Fact.FAILED: (Phase.GAVE_UP, Action.CANCEL_SPAWN),
    },
    Phase.STARTING: {**_LIVES, Fact.READY: (Phase.RUNNING,), Fact.FAULTY: _KILL},
    # One hello for each process; a second one changes nothing.
    Phase.RUNNING: {**_LIVES, Fact.FAULTY: _KILL},
    # A further fault changes nothing: its exit decides what follows.
    Phase.KILLING: {**_LIVES, Fact.STUCK: (Phase.GAVE_UP, Action.LOSE)},
    Phase.STOPPING: {
        Fact.STARTED: _STOP,
        **dict.fromkeys(_EXITS, (Phase.STOPPED, Action.LOSE)),
        Fact.STUCK: (Phase.GAVE_UP, Action.LOSE),
        Fact.FAILED: (Phase.GAVE_UP, Action.LOSE, Action.STOP),
    },
    Phase.BACKOFF: {
        Fact.RESTART_DUE: _QUEUE,
        Fact.START: _QUEUE,
        Fact.STOP: (Phase.STOPPED,),
        Fact.FAILED: (Phase.GAVE_UP,),
        Fact.STARTED: (Phase.BACKOFF, Action.STOP),
    },
    # A process that starts although its start failed is not left running. All else is ignored: it
    # stays visible in the summary that it gave up.
    Phase.GAVE_UP: {Fact.START: _QUEUE, Fact.STARTED: (Phase.GAVE_UP, Action.STOP)},
}
PROCESS_TABLE: Final = complete(Fact, _PROCESS)


# Composable nodes.


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


_NodeRow: TypeAlias = "Mapping[NodeFact, tuple[State, *tuple[NodeAction, ...]]]"

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
        NodeFact.STATUS_QUEUED,
        NodeFact.STATUS_CONSTRUCTING,
        NodeFact.STATUS_LOADED,
        NodeFact.STATUS_UNLOADING,
        NodeFact.STATUS_UNKNOWN,
        NodeFact.STATUS_UNKNOWN_AGAIN,
    }
)
REPORTED: Final = frozenset(
    {
        NodeFact.ACCEPTED,
        NodeFact.REJECTED,
        NodeFact.LOADING,
        NodeFact.LOADED,
        NodeFact.LOAD_FAILED,
        NodeFact.RELOAD_FAILED,
        NodeFact.UNLOADED,
        NodeFact.CRASHED,
        *STATUS,
    }
)
"""Facts about one attempt; they count only for that attempt."""

_LOAD: Final = (State.REQUESTED, NodeAction.LOAD)
_END_OF_LOAD: Final[_NodeRow] = {
    NodeFact.LOADED: (State.LOADED,),
    NodeFact.LOAD_FAILED: (State.LOAD_FAILED,),
    NodeFact.RELOAD_FAILED: (State.LOAD_FAILED, NodeAction.RESTART),
    NodeFact.UNLOADED: (State.UNLOADED,),
    NodeFact.CRASHED: (State.CRASHED, NodeAction.RESTART),
    NodeFact.CONTAINER_LOST: (State.LOST,),
    NodeFact.STATUS_CONSTRUCTING: (State.LOADING,),
    NodeFact.STATUS_LOADED: (State.LOADED,),
    NodeFact.STATUS_UNLOADING: (State.UNLOADING,),
    NodeFact.STATUS_UNKNOWN: (State.REQUESTED, NodeAction.LOAD_AGAIN),
    NodeFact.STATUS_UNKNOWN_AGAIN: (State.LOAD_FAILED,),
}
"""Whether the load was accepted or not: the reports in between may have been dropped."""

_NODE: Final[Mapping[State, _NodeRow]] = {
    State.PENDING: {
        NodeFact.LOAD: _LOAD,
        NodeFact.REFUSED: (State.LOAD_FAILED,),
        NodeFact.LEAVE: (State.UNLOADED,),
    },
    State.REQUESTED: {
        **_END_OF_LOAD,
        NodeFact.ACCEPTED: (State.LOADING,),
        NodeFact.LOADING: (State.LOADING,),
        NodeFact.REJECTED: (State.LOAD_FAILED,),
        NodeFact.SILENT: (State.REQUESTED, NodeAction.QUERY),
        # Without a unique_id there is nothing to cancel yet; ACCEPTED brings it.
        NodeFact.LEAVE: (State.UNLOADING,),
    },
    State.LOADING: {
        **_END_OF_LOAD,
        NodeFact.LEAVE: (State.UNLOADING, NodeAction.CANCEL),
        NodeFact.SILENT: (State.LOADING, NodeAction.QUERY),
        # It was accepted before: the two contradict each other.
        NodeFact.REJECTED: (State.LOADING, NodeAction.QUERY),
    },
    State.LOADED: {
        NodeFact.LEAVE: (State.UNLOADING, NodeAction.UNLOAD),
        NodeFact.UNLOADED: (State.UNLOADED,),
        NodeFact.CRASHED: (State.CRASHED, NodeAction.RESTART),
        NodeFact.CONTAINER_LOST: (State.LOST,),
        NodeFact.STATUS_UNLOADING: (State.UNLOADING,),
        # An attempt that the container does not know after it was accepted never returns.
        NodeFact.STATUS_UNKNOWN: (State.LOST,),
        NodeFact.STATUS_UNKNOWN_AGAIN: (State.LOST,),
        NodeFact.REJECTED: (State.LOADED, NodeAction.QUERY),
        NodeFact.LOAD_FAILED: (State.LOADED, NodeAction.QUERY),
        NodeFact.RELOAD_FAILED: (State.LOADED, NodeAction.QUERY),
    },
    State.UNLOADING: {
        NodeFact.ACCEPTED: (State.UNLOADING, NodeAction.CANCEL),
        NodeFact.REJECTED: (State.UNLOADED,),
        # The constructor was quicker than the cancellation.
        NodeFact.LOADED: (State.UNLOADING, NodeAction.UNLOAD),
        NodeFact.LOAD_FAILED: (State.UNLOADED,),
        NodeFact.RELOAD_FAILED: (State.UNLOADED,),
        NodeFact.UNLOADED: (State.UNLOADED,),
        NodeFact.CRASHED: (State.CRASHED,),
        NodeFact.CONTAINER_LOST: (State.UNLOADED,),
        NodeFact.UNLOAD_REJECTED: (State.UNLOADING, NodeAction.QUERY),
        NodeFact.SILENT: (State.UNLOADING, NodeAction.QUERY),
        # Whether the load was accepted may not have been known before.
        NodeFact.STATUS_QUEUED: (State.UNLOADING, NodeAction.CANCEL),
        NodeFact.STATUS_CONSTRUCTING: (State.UNLOADING, NodeAction.CANCEL),
        NodeFact.STATUS_LOADED: (State.UNLOADING, NodeAction.UNLOAD),
        NodeFact.STATUS_UNKNOWN: (State.UNLOADED,),
        NodeFact.STATUS_UNKNOWN_AGAIN: (State.UNLOADED,),
    },
    State.LOAD_FAILED: {
        NodeFact.LOAD: _LOAD,
        NodeFact.GIVEN_UP: (State.GAVE_UP,),
        NodeFact.LEAVE: (State.UNLOADED,),
    },
    State.UNLOADED: {NodeFact.LOAD: _LOAD},
    State.CRASHED: {
        NodeFact.LOAD: _LOAD,
        NodeFact.GIVEN_UP: (State.GAVE_UP,),
        NodeFact.CONTAINER_LOST: (State.LOST,),
        NodeFact.LEAVE: (State.UNLOADED,),
    },
    # It does not return with its container: it may be what brought that down.
    State.GAVE_UP: {NodeFact.LOAD: _LOAD, NodeFact.LEAVE: (State.UNLOADED,)},
    State.LOST: {
        NodeFact.LOAD: _LOAD,
        NodeFact.REFUSED: (State.LOAD_FAILED,),
        NodeFact.LEAVE: (State.UNLOADED,),
    },
}
NODE_TABLE: Final = complete(NodeFact, _NODE)
