"""Lives of containers, processes and composable nodes: the tables of state and fact.

The container owns its nodes; their table is the supervisor's mirror of what it reported:

* Silence is a question: no answer within the loading timeout leads to a query, never to a guess.
* No late report about an attempt that ended brings a node back.
* A node is never loaded twice: a load is sent again only after the container reported that it does
  not know the attempt, and only once, under a new attempt.
"""

from __future__ import annotations

from enum import Enum, StrEnum, auto
from itertools import product
from typing import TYPE_CHECKING, Final, TypeAlias, TypeVar

from play_launch.supervisor.events import NodeState as State
from play_launch.supervisor.world import Phase

if TYPE_CHECKING:
    from collections.abc import Mapping
    from collections.abc import Set as AbstractSet

    from play_launch.supervisor.world import Node

_State = TypeVar("_State", bound=Enum)
_Fact = TypeVar("_Fact", bound=Enum)
_Cell = TypeVar("_Cell")


def table(
    states: type[_State],
    facts: type[_Fact],
    *rows: tuple[_State | AbstractSet[_State], _Fact | AbstractSet[_Fact], _Cell | None],
) -> dict[_State, dict[_Fact, _Cell | None]]:
    """Make a table of rows: in which states, on which facts, what follows; None: nothing does.

    Raises ValueError unless each cell is stated, and stated once; TypeError for another value.
    """
    made: dict[_State, dict[_Fact, _Cell | None]] = {state: {} for state in states}
    for in_states, on_facts, cell in rows:
        those = {in_states} if isinstance(in_states, Enum) else in_states
        what = {on_facts} if isinstance(on_facts, Enum) else on_facts
        for state, fact in product(those, what):
            if not isinstance(state, states) or not isinstance(fact, facts):
                raise TypeError(f"{state!r}, {fact!r}: no cell of {states} and {facts}")
            if fact in made[state]:
                raise ValueError(f"{state!r}, {fact!r}: stated twice")
            made[state][fact] = cell
    missing = [pair for pair in product(states, facts) if pair[1] not in made[pair[0]]]
    if missing:
        raise ValueError(f"not stated: {missing}")
    return made


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


EXITS: Final = frozenset({Fact.RESTART, Fact.GIVE_UP, Fact.DONE})
_ALIVE: Final = frozenset({Phase.SPAWNING, Phase.STARTING, Phase.RUNNING, Phase.KILLING})
_PENDING: Final = frozenset({Phase.QUEUED, Phase.BACKOFF})
_PHASES: Final = _ALIVE | _PENDING | {Phase.STOPPED, Phase.STOPPING, Phase.GAVE_UP}

PROCESS_TABLE: Final = table(
    Phase,
    Fact,
    ({Phase.STOPPED, Phase.BACKOFF, Phase.GAVE_UP}, Fact.START, Phase.QUEUED),
    (_ALIVE | {Phase.QUEUED, Phase.STOPPING}, Fact.START, None),
    (Phase.QUEUED, Fact.TURN, Phase.SPAWNING),
    (_PHASES - {Phase.QUEUED}, Fact.TURN, None),
    (Phase.SPAWNING, Fact.STARTED, Phase.STARTING),
    (_PHASES - {Phase.SPAWNING}, Fact.STARTED, None),
    # One hello for each process; a second one changes nothing.
    (Phase.STARTING, Fact.READY, Phase.RUNNING),
    (_PHASES - {Phase.STARTING}, Fact.READY, None),
    # A further fault changes nothing: its exit decides what follows.
    ({Phase.STARTING, Phase.RUNNING}, Fact.FAULTY, Phase.KILLING),
    (_PHASES - {Phase.STARTING, Phase.RUNNING}, Fact.FAULTY, None),
    (_PENDING, Fact.STOP, Phase.STOPPED),
    (_ALIVE, Fact.STOP, Phase.STOPPING),
    ({Phase.STOPPED, Phase.STOPPING, Phase.GAVE_UP}, Fact.STOP, None),
    (_ALIVE, Fact.RESTART, Phase.BACKOFF),
    (_ALIVE | {Phase.QUEUED}, Fact.GIVE_UP, Phase.GAVE_UP),
    (_ALIVE, Fact.DONE, Phase.STOPPED),
    (Phase.STOPPING, EXITS, Phase.STOPPED),
    (Phase.QUEUED, EXITS - {Fact.GIVE_UP}, None),
    ({Phase.STOPPED, Phase.BACKOFF, Phase.GAVE_UP}, EXITS, None),
    ({Phase.KILLING, Phase.STOPPING}, Fact.STUCK, Phase.GAVE_UP),
    (_PHASES - {Phase.KILLING, Phase.STOPPING}, Fact.STUCK, None),
    (_PHASES - {Phase.GAVE_UP}, Fact.FAILED, Phase.GAVE_UP),
    # It stays visible in the summary that it gave up.
    (Phase.GAVE_UP, Fact.FAILED, None),
)
"""The phase that follows; None: it stays as it is."""


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


_Then: TypeAlias = tuple[State, *tuple[NodeAction, ...]]

AWAITED: Final = frozenset({State.REQUESTED, State.LOADING, State.UNLOADING})
"""States in which the container owes an answer."""
LOADING: Final = frozenset({State.REQUESTED, State.LOADING})
IDLE: Final = frozenset(
    {
        *(State.PENDING, State.LOAD_FAILED, State.UNLOADED),
        *(State.CRASHED, State.GAVE_UP, State.LOST),
    }
)
"""States in which the container does not have it."""
_DECISIONS: Final = frozenset({NodeFact.LOAD, NodeFact.REFUSED, NodeFact.GIVEN_UP})
_STATUS: Final = frozenset(
    {
        *(NodeFact.STATUS_QUEUED, NodeFact.STATUS_CONSTRUCTING, NodeFact.STATUS_LOADED),
        *(NodeFact.STATUS_UNLOADING, NodeFact.STATUS_UNKNOWN),
    }
)
_REPORTS: Final = _STATUS | {
    *(NodeFact.ACCEPTED, NodeFact.REJECTED, NodeFact.UNLOAD_REJECTED, NodeFact.LOADING),
    *(NodeFact.LOADED, NodeFact.LOAD_FAILED, NodeFact.UNLOADED, NodeFact.CRASHED),
}

NODE_TABLE: Final[Mapping[State, Mapping[NodeFact, _Then | None]]] = table(
    State,
    NodeFact,
    # The container does not have it: reports are of an attempt that ended.
    (IDLE, _REPORTS | {NodeFact.SILENT}, None),
    (IDLE, NodeFact.LOAD, (State.REQUESTED, NodeAction.LOAD)),
    ({State.PENDING, State.LOST}, NodeFact.REFUSED, (State.LOAD_FAILED,)),
    (IDLE - {State.PENDING, State.LOST}, NodeFact.REFUSED, None),
    ({State.LOAD_FAILED, State.CRASHED}, NodeFact.GIVEN_UP, (State.GAVE_UP,)),
    (IDLE - {State.LOAD_FAILED, State.CRASHED}, NodeFact.GIVEN_UP, None),
    (IDLE - {State.UNLOADED}, NodeFact.LEAVE, (State.UNLOADED,)),
    (State.UNLOADED, NodeFact.LEAVE, None),
    # One that gave up does not return with its container: it may be what brought that down.
    (State.CRASHED, NodeFact.CONTAINER_LOST, (State.LOST,)),
    (IDLE - {State.CRASHED}, NodeFact.CONTAINER_LOST, None),
    # Whether the load was accepted or not: the reports in between may have been dropped.
    (LOADING, NodeFact.LOADED, (State.LOADED,)),
    (LOADING, NodeFact.LOAD_FAILED, (State.LOAD_FAILED, NodeAction.RESTART)),
    (LOADING, NodeFact.UNLOADED, (State.UNLOADED,)),
    (LOADING, NodeFact.CRASHED, (State.CRASHED, NodeAction.RESTART)),
    (LOADING, NodeFact.CONTAINER_LOST, (State.LOST,)),
    (LOADING, NodeFact.STATUS_CONSTRUCTING, (State.LOADING,)),
    (LOADING, NodeFact.STATUS_LOADED, (State.LOADED,)),
    (LOADING, NodeFact.STATUS_UNLOADING, (State.UNLOADING,)),
    (LOADING, NodeFact.STATUS_UNKNOWN, (State.REQUESTED, NodeAction.LOAD_AGAIN)),
    (LOADING, _DECISIONS | {NodeFact.UNLOAD_REJECTED, NodeFact.STATUS_QUEUED}, None),
    (State.REQUESTED, {NodeFact.ACCEPTED, NodeFact.LOADING}, (State.LOADING,)),
    (State.REQUESTED, NodeFact.REJECTED, (State.LOAD_FAILED, NodeAction.RESTART)),
    (State.REQUESTED, NodeFact.SILENT, (State.REQUESTED, NodeAction.QUERY)),
    # Without a unique_id there is nothing to cancel yet; ACCEPTED brings it.
    (State.REQUESTED, NodeFact.LEAVE, (State.UNLOADING,)),
    (State.LOADING, {NodeFact.ACCEPTED, NodeFact.LOADING}, None),
    (State.LOADING, NodeFact.LEAVE, (State.UNLOADING, NodeAction.CANCEL)),
    # After it was accepted, a rejection is a contradiction.
    (State.LOADING, {NodeFact.SILENT, NodeFact.REJECTED}, (State.LOADING, NodeAction.QUERY)),
    (State.LOADED, NodeFact.LEAVE, (State.UNLOADING, NodeAction.UNLOAD)),
    (State.LOADED, NodeFact.UNLOADED, (State.UNLOADED,)),
    (State.LOADED, NodeFact.CRASHED, (State.CRASHED, NodeAction.RESTART)),
    # An attempt that the container does not know after it was accepted never returns.
    (State.LOADED, {NodeFact.CONTAINER_LOST, NodeFact.STATUS_UNKNOWN}, (State.LOST,)),
    (State.LOADED, NodeFact.STATUS_UNLOADING, (State.UNLOADING,)),
    (
        State.LOADED,
        {NodeFact.REJECTED, NodeFact.LOAD_FAILED},
        (State.LOADED, NodeAction.QUERY),
    ),
    (State.LOADED, _DECISIONS | {NodeFact.SILENT, NodeFact.UNLOAD_REJECTED}, None),
    (State.LOADED, {NodeFact.ACCEPTED, NodeFact.LOADING, NodeFact.LOADED}, None),
    (State.LOADED, _STATUS - {NodeFact.STATUS_UNLOADING, NodeFact.STATUS_UNKNOWN}, None),
    (State.UNLOADING, NodeFact.ACCEPTED, (State.UNLOADING, NodeAction.CANCEL)),
    # The constructor was quicker than the cancellation.
    (
        State.UNLOADING,
        {NodeFact.LOADED, NodeFact.STATUS_LOADED},
        (State.UNLOADING, NodeAction.UNLOAD),
    ),
    (State.UNLOADING, {NodeFact.REJECTED, NodeFact.LOAD_FAILED}, (State.UNLOADED,)),
    (State.UNLOADING, {NodeFact.UNLOADED, NodeFact.CONTAINER_LOST}, (State.UNLOADED,)),
    (State.UNLOADING, NodeFact.STATUS_UNKNOWN, (State.UNLOADED,)),
    (State.UNLOADING, NodeFact.CRASHED, (State.CRASHED,)),
    (
        State.UNLOADING,
        {NodeFact.UNLOAD_REJECTED, NodeFact.SILENT},
        (State.UNLOADING, NodeAction.QUERY),
    ),
    # Whether the load was accepted may not have been known before.
    (
        State.UNLOADING,
        {NodeFact.STATUS_QUEUED, NodeFact.STATUS_CONSTRUCTING},
        (State.UNLOADING, NodeAction.CANCEL),
    ),
    (State.UNLOADING, _DECISIONS | {NodeFact.LEAVE, NodeFact.LOADING}, None),
    (State.UNLOADING, NodeFact.STATUS_UNLOADING, None),
)
"""The state that follows, and actions; None: nothing does."""


def next_state(node: Node, fact: NodeFact) -> tuple[State, tuple[NodeAction, ...]]:
    """Apply a fact to a node; a load that was sent twice and is unknown has failed."""
    if fact is NodeFact.STATUS_UNKNOWN and node.resent and node.state in LOADING:
        fact = NodeFact.LOAD_FAILED
    state, *actions = NODE_TABLE[node.state][fact] or (node.state,)
    return state, tuple(actions)
