"""What becomes of one member of the system, a container or an ordinary executable: state x input.

Whether it is wanted is data, as systemd and s6 have it (``flagwantup``): starting, stopping and
restarting are inputs like any other, at any time. What follows from a death is decided before the
table is asked (:mod:`play_launch.core.restart`); so the table stays a table.
"""

from __future__ import annotations

from enum import StrEnum, auto
from typing import TYPE_CHECKING, Final, NamedTuple

from msgspec import Struct
from msgspec.structs import replace

from play_launch.core.events import ContainerState

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

MemberState = ContainerState


class MemberInput(StrEnum):
    """What can happen to a member."""

    START = auto()
    """It is wanted."""
    STOP = auto()
    """It is not wanted any more."""
    RESTART = auto()
    """It is wanted, as a new process."""
    SLOT = auto()
    """It is its turn to start, and nothing is left of its last process."""
    READY = auto()
    """A container said hello and was answered; another executable runs."""
    HELLO_MISMATCH = auto()
    """It speaks another version of the protocol."""
    HELLO_OVERDUE = auto()
    CHANNEL_BROKEN = auto()
    """The control channel ended or carried nonsense while the process lives."""
    FROZEN = auto()
    """It lives and does not answer."""
    DIED_RESTART = auto()
    """The process is gone, or could not be started; a restart is within the bounds."""
    DIED_FOR_GOOD = auto()
    """The same, but without a restart."""
    ENDED = auto()
    """The process ended by itself and is not to be started again: no failure."""
    REPLACED = auto()
    """It ended as it was stopped, and is wanted again by now."""
    STUCK = auto()
    """Not even SIGKILL ended it within its limit."""
    RESTART_DUE = auto()
    FAILED = auto()
    """The supervisor's own code for it failed."""


class MemberAction(StrEnum):
    """What has to be done; all of it is begun at once, and what takes time ends in an input."""

    QUEUE = auto()
    """Wait for its turn to start."""
    SPAWN = auto()
    BEGIN = auto()
    """Put it to work: a container loads its nodes."""
    LOSE = auto()
    """Whatever it did is over."""
    KILL = auto()
    STOP_PROCESS = auto()
    """Stop its process, from gentle to hard; without one, it is over at once."""
    WAIT_FOR_RESTART = auto()
    REPORT_GAVE_UP = auto()


class MemberTransition(NamedTuple):
    """An entry of the table."""

    state: MemberState
    actions: tuple[MemberAction, ...] = ()


class MemberRecord(Struct, frozen=True, kw_only=True):
    """What has to be remembered between two inputs."""

    state: MemberState = ContainerState.STOPPED
    wanted: bool = False
    """Whether somebody wants it to run; what it is doing about that is its state."""


State, Said, Do = MemberState, MemberInput, MemberAction


def _row(
    state: MemberState,
    answers: Mapping[MemberInput, tuple[MemberState, *tuple[MemberAction, ...]]],
    ignores: Iterable[MemberInput],
) -> dict[MemberInput, MemberTransition]:
    row = {said: MemberTransition(then, tuple(todo)) for said, (then, *todo) in answers.items()}
    for said in ignores:
        if said in row:
            msg = f"{state}: {said} is both answered and ignored"
            raise ValueError(msg)
        row[said] = MemberTransition(state)
    return row


_TALK: Final = (
    Said.READY,
    Said.HELLO_MISMATCH,
    Said.HELLO_OVERDUE,
    Said.CHANNEL_BROKEN,
    Said.FROZEN,
)
DEATHS: Final = frozenset({Said.DIED_RESTART, Said.DIED_FOR_GOOD, Said.ENDED})
_DEATHS: Final = (*DEATHS, Said.REPLACED)
_START: Final = (State.STARTING, Do.QUEUE)
_STOP: Final = (State.STOPPING, Do.STOP_PROCESS)
_KILL: Final = (State.KILLING, Do.KILL)
# What still runs of it is stopped in order.
_FAILED: Final = (State.GAVE_UP, Do.LOSE, Do.REPORT_GAVE_UP, Do.STOP_PROCESS)
_STUCK: Final = (State.GAVE_UP, Do.LOSE, Do.REPORT_GAVE_UP)

TABLE: Final[Mapping[MemberState, Mapping[MemberInput, MemberTransition]]] = {
    State.STOPPED: _row(
        State.STOPPED,
        {
            Said.START: _START,
            Said.RESTART: _START,
            Said.FAILED: (State.GAVE_UP, Do.REPORT_GAVE_UP),
        },
        {Said.STOP, Said.SLOT, Said.RESTART_DUE, Said.STUCK, *_TALK, *_DEATHS},
    ),
    State.STARTING: _row(
        State.STARTING,
        {
            Said.SLOT: (State.STARTING, Do.SPAWN),
            Said.READY: (State.RUNNING, Do.BEGIN),
            Said.HELLO_MISMATCH: _KILL,
            Said.HELLO_OVERDUE: _KILL,
            Said.CHANNEL_BROKEN: _KILL,
            Said.DIED_RESTART: (State.BACKOFF, Do.WAIT_FOR_RESTART),
            Said.DIED_FOR_GOOD: (State.GAVE_UP, Do.REPORT_GAVE_UP),
            Said.ENDED: (State.STOPPED,),
            Said.STOP: _STOP,
            Said.RESTART: _STOP,
            Said.FAILED: (State.GAVE_UP, Do.REPORT_GAVE_UP, Do.STOP_PROCESS),
        },
        # Its silence is measured by HELLO_OVERDUE.
        {Said.START, Said.RESTART_DUE, Said.FROZEN, Said.STUCK, Said.REPLACED},
    ),
    State.RUNNING: _row(
        State.RUNNING,
        {
            Said.HELLO_MISMATCH: _KILL,
            Said.CHANNEL_BROKEN: _KILL,
            Said.FROZEN: _KILL,
            Said.DIED_RESTART: (State.BACKOFF, Do.LOSE, Do.WAIT_FOR_RESTART),
            Said.DIED_FOR_GOOD: (State.GAVE_UP, Do.LOSE, Do.REPORT_GAVE_UP),
            Said.ENDED: (State.STOPPED, Do.LOSE),
            Said.STOP: _STOP,
            Said.RESTART: _STOP,
            Said.FAILED: _FAILED,
        },
        {
            Said.START,
            Said.SLOT,
            Said.RESTART_DUE,
            # One hello for each process; a second one says nothing new.
            Said.READY,
            Said.HELLO_OVERDUE,
            Said.STUCK,
            Said.REPLACED,
        },
    ),
    # It was sent SIGKILL: a further verdict changes nothing, its death decides what follows.
    State.KILLING: _row(
        State.KILLING,
        {
            Said.DIED_RESTART: (State.BACKOFF, Do.LOSE, Do.WAIT_FOR_RESTART),
            Said.DIED_FOR_GOOD: (State.GAVE_UP, Do.LOSE, Do.REPORT_GAVE_UP),
            Said.ENDED: (State.STOPPED, Do.LOSE),
            Said.STUCK: _STUCK,
            Said.STOP: _STOP,
            Said.FAILED: _FAILED,
        },
        {Said.START, Said.RESTART, Said.SLOT, Said.RESTART_DUE, Said.REPLACED, *_TALK},
    ),
    State.BACKOFF: _row(
        State.BACKOFF,
        {
            Said.RESTART_DUE: _START,
            Said.START: _START,
            Said.RESTART: _START,
            Said.STOP: (State.STOPPED,),
            Said.FAILED: (State.GAVE_UP, Do.REPORT_GAVE_UP),
        },
        {Said.SLOT, Said.STUCK, *_TALK, *_DEATHS},
    ),
    State.GAVE_UP: _row(
        State.GAVE_UP,
        {Said.START: _START, Said.RESTART: _START},
        # It stays visible in the summary that it gave up.
        {
            Said.STOP,
            Said.SLOT,
            Said.RESTART_DUE,
            Said.STUCK,
            Said.FAILED,
            *_TALK,
            *_DEATHS,
        },
    ),
    State.STOPPING: _row(
        State.STOPPING,
        {
            Said.DIED_RESTART: (State.STOPPED, Do.LOSE),
            Said.DIED_FOR_GOOD: (State.STOPPED, Do.LOSE),
            Said.ENDED: (State.STOPPED, Do.LOSE),
            Said.REPLACED: (State.STARTING, Do.LOSE, Do.QUEUE),
            Said.STUCK: _STUCK,
            Said.FAILED: _FAILED,
        },
        {Said.START, Said.RESTART, Said.STOP, Said.SLOT, Said.RESTART_DUE, *_TALK},
    ),
}

_WANTED: Final[Mapping[MemberInput, bool]] = {
    Said.START: True,
    Said.RESTART: True,
    Said.STOP: False,
    Said.DIED_FOR_GOOD: False,
    Said.ENDED: False,
    Said.STUCK: False,
    Said.FAILED: False,
}
"""Inputs that say or change whether it is wanted."""


class MemberStep(NamedTuple):
    """Result of one input."""

    record: MemberRecord
    actions: tuple[MemberAction, ...]


def step(record: MemberRecord, said: MemberInput) -> MemberStep:
    """Apply one input."""
    if said in DEATHS and record.state is State.STOPPING and record.wanted:
        said = Said.REPLACED
    state, actions = TABLE[record.state][said]
    wanted = _WANTED.get(said, record.wanted)
    return MemberStep(replace(record, state=state, wanted=wanted), actions)
