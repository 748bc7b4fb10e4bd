"""What becomes of one declared composable node: a table of state x input.

The container owns the node; this is the supervisor's mirror of what the container stated. Three
rules shape the table:

* Silence is a question. No answer within the loading timeout leads to a query, never to a guess.
* A dead node stays dead. No late word about an attempt that ended brings it back.
* A node is never loaded twice. A load is sent anew only after the container said that it does not
  know the attempt, and only once, under a new attempt number.

Words are matched by attempt and unique_id, so nothing that is said about an old attempt reaches a
newer one. Times are seconds of any monotonic clock and are passed in.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum, auto
from typing import TYPE_CHECKING, Final, NamedTuple

from play_launch.core.events import NodeState

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping


class NodeInput(StrEnum):
    """What can happen to a node."""

    CONTAINER_READY = auto()
    CONTAINER_LOST = auto()
    UNLOAD_REQUESTED = auto()
    RELOAD_DUE = auto()
    """The pause after a crash is over."""
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
    CRASHED = auto()
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
    PLAN_RELOAD = auto()
    REPORT_LOADED = auto()
    REPORT_CONFIRMED = auto()
    """Loaded, but no event had told so: the container was asked."""
    REPORT_SLOW = auto()
    REPORT_FAILED = auto()
    REPORT_FORGOTTEN = auto()
    """The container lives and does not know the node any more."""
    REPORT_CRASHED = auto()
    REPORT_UNLOADED = auto()
    REPORT_LOST = auto()


class Transition(NamedTuple):
    """An entry of the table."""

    state: NodeState
    actions: tuple[NodeAction, ...] = ()


State, Said, Do = NodeState, NodeInput, NodeAction

WAITING: Final = frozenset({State.REQUESTED, State.LOADING, State.UNLOADING})
"""States in which the container owes an answer, so that silence means something."""

SETTLED: Final = frozenset({State.LOADED, State.LOAD_FAILED, State.UNLOADED, State.CRASHED})
"""States that last until something new happens."""

_FROM_CONTAINER: Final = frozenset(
    {
        Said.ACCEPTED,
        Said.REJECTED,
        Said.LOADING,
        Said.LOADED,
        Said.LOAD_FAILED,
        Said.UNLOADED,
        Said.CRASHED,
        Said.STATUS_CONSTRUCTING,
        Said.STATUS_LOADED,
        Said.STATUS_UNLOADING,
        Said.STATUS_UNKNOWN,
        Said.STATUS_UNKNOWN_AGAIN,
    }
)
"""Words about one attempt; they count only for that attempt."""

_STATUS: Final = frozenset(
    {
        Said.STATUS_CONSTRUCTING,
        Said.STATUS_LOADED,
        Said.STATUS_UNLOADING,
        Said.STATUS_UNKNOWN,
        Said.STATUS_UNKNOWN_AGAIN,
    }
)

_LOADS_ANEW: Final = frozenset({Said.CONTAINER_READY, Said.RELOAD_DUE})


def _row(
    state: NodeState,
    answers: Mapping[NodeInput, tuple[NodeState, *tuple[NodeAction, ...]]],
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
_CRASH: Final = (State.CRASHED, Do.REPORT_CRASHED, Do.PLAN_RELOAD)
_LOST: Final = (State.LOST, Do.REPORT_LOST)
_TIMERS: Final = (Said.SILENT, Said.RELOAD_DUE)

TABLE: Final[Mapping[NodeState, Mapping[NodeInput, Transition]]] = {
    State.PENDING: _row(
        State.PENDING,
        {
            Said.CONTAINER_READY: _NEW_LOAD,
            Said.UNLOAD_REQUESTED: (State.UNLOADED, Do.REPORT_UNLOADED),
        },
        {Said.CONTAINER_LOST, Said.UNLOAD_REJECTED, *_TIMERS, *_FROM_CONTAINER},
    ),
    State.REQUESTED: _row(
        State.REQUESTED,
        {
            Said.ACCEPTED: (State.LOADING,),
            Said.LOADING: (State.LOADING,),
            Said.REJECTED: (State.LOAD_FAILED, Do.REPORT_FAILED),
            # The answers in between may have been dropped; the last word counts.
            Said.LOADED: (State.LOADED, Do.REPORT_LOADED),
            Said.LOAD_FAILED: (State.LOAD_FAILED, Do.REPORT_FAILED),
            Said.UNLOADED: (State.UNLOADED, Do.REPORT_UNLOADED),
            Said.CRASHED: _CRASH,
            Said.CONTAINER_LOST: _LOST,
            Said.SILENT: (State.REQUESTED, Do.SEND_QUERY),
            Said.STATUS_CONSTRUCTING: (State.LOADING, Do.REPORT_SLOW),
            Said.STATUS_LOADED: (State.LOADED, Do.REPORT_CONFIRMED),
            Said.STATUS_UNLOADING: (State.UNLOADING,),
            Said.STATUS_UNKNOWN: (State.REQUESTED, Do.RESEND_LOAD),
            Said.STATUS_UNKNOWN_AGAIN: (State.LOAD_FAILED, Do.REPORT_FORGOTTEN),
            # Without a unique_id there is nothing to cancel yet; ACCEPTED brings it.
            Said.UNLOAD_REQUESTED: (State.UNLOADING,),
        },
        {Said.CONTAINER_READY, Said.RELOAD_DUE, Said.UNLOAD_REJECTED},
    ),
    State.LOADING: _row(
        State.LOADING,
        {
            Said.LOADED: (State.LOADED, Do.REPORT_LOADED),
            Said.LOAD_FAILED: (State.LOAD_FAILED, Do.REPORT_FAILED),
            Said.UNLOADED: (State.UNLOADED, Do.REPORT_UNLOADED),
            Said.CRASHED: _CRASH,
            Said.CONTAINER_LOST: _LOST,
            Said.SILENT: (State.LOADING, Do.SEND_QUERY),
            Said.STATUS_CONSTRUCTING: (State.LOADING, Do.REPORT_SLOW),
            Said.STATUS_LOADED: (State.LOADED, Do.REPORT_CONFIRMED),
            Said.STATUS_UNLOADING: (State.UNLOADING,),
            Said.STATUS_UNKNOWN: (State.REQUESTED, Do.RESEND_LOAD),
            Said.STATUS_UNKNOWN_AGAIN: (State.LOAD_FAILED, Do.REPORT_FORGOTTEN),
            Said.UNLOAD_REQUESTED: (State.UNLOADING, Do.SEND_CANCEL),
            # It was accepted before: the two contradict each other, so ask.
            Said.REJECTED: (State.LOADING, Do.SEND_QUERY),
        },
        {Said.CONTAINER_READY, Said.RELOAD_DUE, Said.UNLOAD_REJECTED, Said.ACCEPTED, Said.LOADING},
    ),
    State.LOADED: _row(
        State.LOADED,
        {
            Said.UNLOADED: (State.UNLOADED, Do.REPORT_UNLOADED),
            Said.CRASHED: _CRASH,
            Said.CONTAINER_LOST: _LOST,
            Said.UNLOAD_REQUESTED: (State.UNLOADING, Do.SEND_UNLOAD),
            Said.STATUS_UNLOADING: (State.UNLOADING,),
            # An attempt that the container does not know after it was accepted never comes back.
            Said.STATUS_UNKNOWN: (State.LOST, Do.REPORT_FORGOTTEN),
            Said.STATUS_UNKNOWN_AGAIN: (State.LOST, Do.REPORT_FORGOTTEN),
            Said.REJECTED: (State.LOADED, Do.SEND_QUERY),
            Said.LOAD_FAILED: (State.LOADED, Do.SEND_QUERY),
        },
        {
            Said.CONTAINER_READY,
            *_TIMERS,
            Said.UNLOAD_REJECTED,
            Said.ACCEPTED,
            Said.LOADING,
            Said.LOADED,
            Said.STATUS_LOADED,
            Said.STATUS_CONSTRUCTING,
        },
    ),
    State.UNLOADING: _row(
        State.UNLOADING,
        {
            Said.ACCEPTED: (State.UNLOADING, Do.SEND_CANCEL),
            Said.REJECTED: (State.UNLOADED, Do.REPORT_UNLOADED),
            # The constructor was quicker than the cancellation.
            Said.LOADED: (State.UNLOADING, Do.SEND_UNLOAD),
            Said.LOAD_FAILED: (State.UNLOADED, Do.REPORT_UNLOADED),
            Said.UNLOADED: (State.UNLOADED, Do.REPORT_UNLOADED),
            # Nobody wants it any more, so it is not brought back.
            Said.CRASHED: (State.CRASHED, Do.REPORT_CRASHED),
            Said.CONTAINER_LOST: (State.UNLOADED, Do.REPORT_UNLOADED),
            Said.UNLOAD_REJECTED: (State.UNLOADING, Do.SEND_QUERY),
            Said.SILENT: (State.UNLOADING, Do.SEND_QUERY),
            Said.STATUS_CONSTRUCTING: (State.UNLOADING, Do.SEND_CANCEL, Do.REPORT_SLOW),
            Said.STATUS_LOADED: (State.UNLOADING, Do.SEND_UNLOAD),
            Said.STATUS_UNKNOWN: (State.UNLOADED, Do.REPORT_UNLOADED),
            Said.STATUS_UNKNOWN_AGAIN: (State.UNLOADED, Do.REPORT_UNLOADED),
        },
        {
            Said.CONTAINER_READY,
            Said.RELOAD_DUE,
            Said.LOADING,
            Said.UNLOAD_REQUESTED,
            Said.STATUS_UNLOADING,
        },
    ),
    State.LOAD_FAILED: _row(
        State.LOAD_FAILED,
        # A new container process is a new chance.
        {
            Said.CONTAINER_READY: _NEW_LOAD,
            Said.UNLOAD_REQUESTED: (State.UNLOADED, Do.REPORT_UNLOADED),
        },
        {Said.CONTAINER_LOST, Said.UNLOAD_REJECTED, *_TIMERS, *_FROM_CONTAINER},
    ),
    State.UNLOADED: _row(
        State.UNLOADED,
        # A new container process is brought up as declared: a container that was ended from
        # outside tells that it unloads its nodes, too.
        {Said.CONTAINER_READY: _NEW_LOAD},
        {
            Said.CONTAINER_LOST,
            Said.UNLOAD_REQUESTED,
            Said.UNLOAD_REJECTED,
            *_TIMERS,
            *_FROM_CONTAINER,
        },
    ),
    State.CRASHED: _row(
        State.CRASHED,
        {
            Said.RELOAD_DUE: _NEW_LOAD,
            Said.CONTAINER_LOST: _LOST,
            Said.UNLOAD_REQUESTED: (State.UNLOADED, Do.REPORT_UNLOADED),
        },
        {Said.CONTAINER_READY, Said.SILENT, Said.UNLOAD_REJECTED, *_FROM_CONTAINER},
    ),
    State.LOST: _row(
        State.LOST,
        {
            Said.CONTAINER_READY: _NEW_LOAD,
            Said.UNLOAD_REQUESTED: (State.UNLOADED, Do.REPORT_UNLOADED),
        },
        {Said.CONTAINER_LOST, Said.UNLOAD_REJECTED, *_TIMERS, *_FROM_CONTAINER},
    ),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Patience:
    """How long silence is just silence, in seconds."""

    loading_timeout: float = 10.0
    """From a request or question to the (next) question."""
    report_interval: float = 15.0
    """From one report of a slow constructor to the next."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NodeRecord:
    """What is known about one node."""

    state: NodeState = NodeState.PENDING
    attempt: int = 0
    """Number of the latest load; 0 before the first."""
    unique_id: int = 0
    """The container's number for that load; 0 while unknown."""
    resent: bool = False
    unwanted: bool = False
    """We asked for it to be unloaded; a new container process does not get it either."""
    sent_at: float = 0.0
    """When that load was sent, in seconds."""
    ask_at: float | None = None
    """When silence becomes a question, in seconds; None where no answer is due."""


class Step(NamedTuple):
    """Result of one input."""

    record: NodeRecord
    actions: tuple[NodeAction, ...] = ()
    ignored: str = ""
    """Why the input did not count at all; empty when it went through the table."""


def step(
    record: NodeRecord,
    said: NodeInput,
    *,
    now: float,
    patience: Patience,
    next_attempt: int,
    attempt: int = 0,
    unique_id: int = 0,
) -> Step:
    """Apply one input.

    ``attempt`` and ``unique_id`` are those that the container named (0: none). ``next_attempt``
    is used up when an action of the result is SEND_LOAD or RESEND_LOAD; it must be larger than
    every number used before.
    """
    if why := _mismatch(record, said, attempt, unique_id):
        return Step(record, ignored=why)
    if record.unwanted and said in _LOADS_ANEW:
        return Step(record, ignored="nobody wants it any more")
    if said is NodeInput.STATUS_UNKNOWN and record.resent:
        said = NodeInput.STATUS_UNKNOWN_AGAIN
    state, actions = TABLE[record.state][said]

    unwanted = record.unwanted or said is NodeInput.UNLOAD_REQUESTED
    after = replace(record, state=state, unwanted=unwanted)
    if said in _FROM_CONTAINER and unique_id and not record.unique_id:
        after = replace(after, unique_id=unique_id)
    if NodeAction.SEND_LOAD in actions or NodeAction.RESEND_LOAD in actions:
        after = replace(
            after,
            attempt=next_attempt,
            unique_id=0,
            resent=NodeAction.RESEND_LOAD in actions,
            sent_at=now,
        )
    return Step(replace(after, ask_at=_ask_at(record, after, said, now, patience)), actions)


def is_silent(record: NodeRecord, now: float) -> bool:
    """Tell whether SILENT is due."""
    return record.ask_at is not None and now >= record.ask_at


def _mismatch(record: NodeRecord, said: NodeInput, attempt: int, unique_id: int) -> str:
    if said in _FROM_CONTAINER:
        if attempt == 0 or attempt != record.attempt:
            return f"{said} is about attempt {attempt}, the latest is {record.attempt}"
    elif said is NodeInput.UNLOAD_REJECTED:
        if unique_id == 0 or record.unique_id == 0:
            return f"{said} names no node"
    else:
        return ""
    if unique_id and record.unique_id and unique_id != record.unique_id:
        return f"{said} is about unique_id {unique_id}, the node has {record.unique_id}"
    return ""


def _ask_at(
    before: NodeRecord, after: NodeRecord, said: NodeInput, now: float, patience: Patience
) -> float | None:
    if after.state not in WAITING:
        return None
    if said is NodeInput.STATUS_CONSTRUCTING:
        return now + patience.report_interval
    changed = after.state is not before.state or after.attempt != before.attempt
    if changed or said is NodeInput.SILENT or said in _STATUS:
        return now + patience.loading_timeout
    return before.ask_at
