"""What becomes of one declared composable node: the table of state x input, applied.

The container owns the node; this is the supervisor's mirror of what the container stated. These
rules shape the table:

* Silence is a question. No answer within the loading timeout leads to a query, never to a guess.
* A dead node stays dead. No late word about an attempt that ended brings it back.
* A node that crashes is followed up once: what follows is decided in
  :mod:`play_launch.core.crash`, and comes back as RELOAD_DUE or GIVEN_UP. A reload that fails is
  followed up like the crash before it.
* A node is never loaded twice. A load is sent anew only after the container said that it does not
  know the attempt, and only once, under a new attempt number.

Words are matched by attempt and unique_id, so nothing that is said about an old attempt reaches a
newer one. Times are seconds of any monotonic clock and are passed in.
"""

from __future__ import annotations

from typing import Final, NamedTuple

from msgspec import Struct
from msgspec.structs import replace

from play_launch.core.events import NodeState
from play_launch.core.node_table import FROM_CONTAINER, TABLE, WAITING, NodeAction, NodeInput

_STATUS: Final = frozenset(
    {
        NodeInput.STATUS_QUEUED,
        NodeInput.STATUS_CONSTRUCTING,
        NodeInput.STATUS_LOADED,
        NodeInput.STATUS_UNLOADING,
        NodeInput.STATUS_UNKNOWN,
        NodeInput.STATUS_UNKNOWN_AGAIN,
    }
)

_RELOAD_FAILURES: Final = frozenset(
    {
        (NodeState.REQUESTED, NodeInput.REJECTED),
        (NodeState.REQUESTED, NodeInput.LOAD_FAILED),
        (NodeState.REQUESTED, NodeInput.STATUS_UNKNOWN_AGAIN),
        (NodeState.LOADING, NodeInput.LOAD_FAILED),
        (NodeState.LOADING, NodeInput.STATUS_UNKNOWN_AGAIN),
    }
)
"""Where a failed load is a failed reload, if it was one."""

_WANTED: Final = {
    NodeInput.UNLOAD_REQUESTED: False,
    NodeInput.LOAD_REQUESTED: True,
    NodeInput.RELOAD_REQUESTED: True,
    NodeInput.WANTED: True,
}
"""Inputs that say whether it is wanted."""

_REPLACING: Final = frozenset({NodeInput.LOAD_REQUESTED, NodeInput.RELOAD_REQUESTED})

_LEFT: Final = frozenset(
    (NodeState.UNLOADING, said)
    for said, (state, _) in TABLE[NodeState.UNLOADING].items()
    if state in {NodeState.UNLOADED, NodeState.CRASHED} and said is not NodeInput.CONTAINER_LOST
)
"""Where a node that was being unloaded is gone, and its container is there."""

_LOADS_ANEW: Final = frozenset({NodeInput.CONTAINER_READY, NodeInput.RELOAD_DUE})


class Patience(Struct, frozen=True, kw_only=True):
    """How long silence is just silence, in seconds."""

    loading_timeout: float = 10.0
    """From a request or question to the (next) question."""
    report_interval: float = 15.0
    """From one report of a slow constructor to the next."""


class NodeRecord(Struct, frozen=True, kw_only=True):
    """What is known about one node."""

    state: NodeState = NodeState.PENDING
    attempt: int = 0
    """Number of the latest load; 0 before the first."""
    unique_id: int = 0
    """The container's number for that load; 0 while unknown."""
    resent: bool = False
    is_reload: bool = False
    """Whether that load followed a crash."""
    wanted: bool = True
    """Whether somebody wants it; an unwanted node does not come back with its container either."""
    replaces: bool = False
    """Whether it is loaded again as soon as it has left: that was asked for while it was there."""
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
    if not record.wanted and said in _LOADS_ANEW:
        return Step(record, ignored="nobody wants it any more")
    if said is NodeInput.STATUS_UNKNOWN and record.resent:
        said = NodeInput.STATUS_UNKNOWN_AGAIN
    if record.is_reload and (record.state, said) in _RELOAD_FAILURES:
        said = NodeInput.RELOAD_FAILED
    if record.replaces and (record.state, said) in _LEFT:
        said = NodeInput.REPLACED
    state, actions = TABLE[record.state][said]

    wanted = _WANTED.get(said, record.wanted)
    asked = said in _REPLACING or (record.replaces and said not in _WANTED)
    replaces = state is NodeState.UNLOADING and asked
    after = replace(record, state=state, wanted=wanted, replaces=replaces)
    if said in FROM_CONTAINER and unique_id and not record.unique_id:
        after = replace(after, unique_id=unique_id)
    if NodeAction.SEND_LOAD in actions or NodeAction.RESEND_LOAD in actions:
        after = replace(
            after,
            attempt=next_attempt,
            unique_id=0,
            resent=NodeAction.RESEND_LOAD in actions,
            is_reload=said is NodeInput.RELOAD_DUE
            or (record.is_reload and NodeAction.RESEND_LOAD in actions),
            sent_at=now,
        )
    return Step(replace(after, ask_at=_ask_at(record, after, said, now, patience)), actions)


def is_silent(record: NodeRecord, now: float) -> bool:
    """Return whether SILENT is due."""
    return record.ask_at is not None and now >= record.ask_at


def _mismatch(record: NodeRecord, said: NodeInput, attempt: int, unique_id: int) -> str:
    if said in FROM_CONTAINER:
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
