"""Lives of containers, processes and composable nodes: the tables of state and fact.

The container owns its nodes; their table is the supervisor's mirror of what it reported:

* Silence is a question: no answer within the loading timeout leads to a query, never to a guess.
* No late report about an attempt that ended brings a node back.
* A node is never loaded twice: a load is sent again only after the container reported that it does
  not know the attempt, and only once, under a new attempt.
"""

from __future__ import annotations

from enum import StrEnum, auto
from typing import TYPE_CHECKING, Final, TypeAlias

from play_launch.supervisor.events import NodeState as State
from play_launch.supervisor.world import Phase

if TYPE_CHECKING:
    from collections.abc import Mapping

    from play_launch.supervisor.world import Node

# Containers and ordinary processes.


class Fact(StrEnum):
    """What can happen to a process."""

    START = auto()
    """A start was requested that has not begun, or a restart is due."""
    TURN = auto()
    """Its conditions are met, and nothing is left of its last process."""
    STARTED = auto()
    READY = auto()
    """A container said hello; another process runs."""
    FAULTY = auto()
    """It has to be killed."""
    STOP = auto()
    RESTART = auto()
    """It exited or could not be started, and is restarted."""
    GIVE_UP = auto()
    """The same, or a condition of its start cannot be met; and it is not restarted."""
    DONE = auto()
    """It exited, which is no failure."""
    STUCK = auto()
    """Not even SIGKILL ended it within its limit."""
    FAILED = auto()
    """The supervisor's own code for it failed."""


_Row: TypeAlias = "Mapping[Fact, Phase]"

EXITS: Final = frozenset({Fact.RESTART, Fact.GIVE_UP, Fact.DONE})
_FAILS: Final[_Row] = {Fact.FAILED: Phase.GAVE_UP}
_RUNS: Final[_Row] = {
    Fact.RESTART: Phase.BACKOFF,
    Fact.GIVE_UP: Phase.GAVE_UP,
    Fact.DONE: Phase.STOPPED,
    Fact.STOP: Phase.STOPPING,
    **_FAILS,
}

PROCESS_TABLE: Final[Mapping[Phase, _Row]] = {
    Phase.STOPPED: {**_FAILS, Fact.START: Phase.QUEUED},
    Phase.QUEUED: {
        **_FAILS,
        Fact.TURN: Phase.SPAWNING,
        Fact.GIVE_UP: Phase.GAVE_UP,
        Fact.STOP: Phase.STOPPED,
    },
    Phase.SPAWNING: {**_RUNS, Fact.STARTED: Phase.STARTING},
    Phase.STARTING: {**_RUNS, Fact.READY: Phase.RUNNING, Fact.FAULTY: Phase.KILLING},
    # One hello for each process; a second one changes nothing.
    Phase.RUNNING: {**_RUNS, Fact.FAULTY: Phase.KILLING},
    # A further fault changes nothing: its exit decides what follows.
    Phase.KILLING: {**_RUNS, Fact.STUCK: Phase.GAVE_UP},
    Phase.STOPPING: {
        **_FAILS,
        **dict.fromkeys(EXITS, Phase.STOPPED),
        Fact.STUCK: Phase.GAVE_UP,
    },
    Phase.BACKOFF: {
        **_FAILS,
        Fact.START: Phase.QUEUED,
        Fact.STOP: Phase.STOPPED,
    },
    # All else is ignored: it stays visible in the summary that it gave up.
    Phase.GAVE_UP: {Fact.START: Phase.QUEUED},
}
"""The phase that follows; a fact that is not in a row leaves the phase as it is."""


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
    UNLOADED = auto()
    CRASHED = auto()
    STATUS_QUEUED = auto()
    """The load waits for others of the same container."""
    STATUS_CONSTRUCTING = auto()
    STATUS_LOADED = auto()
    STATUS_UNLOADING = auto()
    STATUS_UNKNOWN = auto()
    """The container was queried and does not know the attempt."""


class NodeAction(StrEnum):
    """What follows from a fact besides the state."""

    LOAD = auto()
    LOAD_AGAIN = auto()
    QUERY = auto()
    CANCEL = auto()
    UNLOAD = auto()
    RESTART = auto()
    """Decide whether it is loaded again after a crash, or a reload that failed."""


_NodeRow: TypeAlias = "Mapping[NodeFact, tuple[State, *tuple[NodeAction, ...]]]"

AWAITED: Final = frozenset({State.REQUESTED, State.LOADING, State.UNLOADING})
"""States in which the container owes an answer."""
LOADING: Final = frozenset({State.REQUESTED, State.LOADING})
IDLE: Final = frozenset(State) - AWAITED - {State.LOADED}
"""States in which the container does not have it."""

_LOAD: Final = (State.REQUESTED, NodeAction.LOAD)
_FAILED: Final = (State.LOAD_FAILED, NodeAction.RESTART)
_END_OF_LOAD: Final[_NodeRow] = {
    NodeFact.LOADED: (State.LOADED,),
    NodeFact.LOAD_FAILED: _FAILED,
    NodeFact.UNLOADED: (State.UNLOADED,),
    NodeFact.CRASHED: (State.CRASHED, NodeAction.RESTART),
    NodeFact.CONTAINER_LOST: (State.LOST,),
    NodeFact.STATUS_CONSTRUCTING: (State.LOADING,),
    NodeFact.STATUS_LOADED: (State.LOADED,),
    NodeFact.STATUS_UNLOADING: (State.UNLOADING,),
    NodeFact.STATUS_UNKNOWN: (State.REQUESTED, NodeAction.LOAD_AGAIN),
}
"""Whether the load was accepted or not: the reports in between may have been dropped."""

NODE_TABLE: Final[Mapping[State, _NodeRow]] = {
    State.PENDING: {
        NodeFact.LOAD: _LOAD,
        NodeFact.REFUSED: (State.LOAD_FAILED,),
        NodeFact.LEAVE: (State.UNLOADED,),
    },
    State.REQUESTED: {
        **_END_OF_LOAD,
        NodeFact.ACCEPTED: (State.LOADING,),
        NodeFact.LOADING: (State.LOADING,),
        NodeFact.REJECTED: _FAILED,
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
        NodeFact.REJECTED: (State.LOADED, NodeAction.QUERY),
        NodeFact.LOAD_FAILED: (State.LOADED, NodeAction.QUERY),
    },
    State.UNLOADING: {
        NodeFact.ACCEPTED: (State.UNLOADING, NodeAction.CANCEL),
        NodeFact.REJECTED: (State.UNLOADED,),
        # The constructor was quicker than the cancellation.
        NodeFact.LOADED: (State.UNLOADING, NodeAction.UNLOAD),
        NodeFact.LOAD_FAILED: (State.UNLOADED,),
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
"""The state that follows, and actions; a fact that is not in a row changes nothing."""


def next_state(node: Node, fact: NodeFact) -> tuple[State, tuple[NodeAction, ...]]:
    """Apply a fact to a node; a load that was sent twice and is unknown has failed."""
    if fact is NodeFact.STATUS_UNKNOWN and node.resent and node.state in LOADING:
        fact = NodeFact.LOAD_FAILED
    state, *actions = NODE_TABLE[node.state].get(fact, (node.state,))
    return state, tuple(actions)
