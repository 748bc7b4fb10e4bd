"""What becomes of one container process: a table of state x input.

Whether a death may be followed by a restart is decided before the table is asked
(:mod:`play_launch.core.restart`); so the table stays a table.
"""

from __future__ import annotations

from enum import StrEnum, auto
from typing import TYPE_CHECKING, Final, NamedTuple

from play_launch.core.events import ContainerState

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping


class ContainerInput(StrEnum):
    """What can happen to a container."""

    START_REQUESTED = auto()
    HELLO = auto()
    """It said hello and was answered."""
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
    ENDED_ITSELF = auto()
    """The process ended in order because one of its nodes wanted that: no failure, no restart."""
    RESTART_DUE = auto()
    STOP_REQUESTED = auto()
    FAILED = auto()
    """The supervisor's own code for it failed; its process is stopped next to the table."""


class ContainerAction(StrEnum):
    """What the actor has to do."""

    SPAWN = auto()
    LOAD_NODES = auto()
    LOSE_NODES = auto()
    KILL = auto()
    STOP_PROCESS = auto()
    WAIT_FOR_RESTART = auto()
    REPORT_GAVE_UP = auto()


class ContainerTransition(NamedTuple):
    """An entry of the table."""

    state: ContainerState
    actions: tuple[ContainerAction, ...] = ()


State, Said, Do = ContainerState, ContainerInput, ContainerAction


def _row(
    state: ContainerState,
    answers: Mapping[ContainerInput, tuple[ContainerState, *tuple[ContainerAction, ...]]],
    ignores: Iterable[ContainerInput],
) -> dict[ContainerInput, ContainerTransition]:
    row = {said: ContainerTransition(then, tuple(todo)) for said, (then, *todo) in answers.items()}
    for said in ignores:
        if said in row:
            msg = f"{state}: {said} is both answered and ignored"
            raise ValueError(msg)
        row[said] = ContainerTransition(state)
    return row


_TALK: Final = (
    Said.HELLO,
    Said.HELLO_MISMATCH,
    Said.HELLO_OVERDUE,
    Said.CHANNEL_BROKEN,
    Said.FROZEN,
)
_DEATH: Final = (Said.DIED_RESTART, Said.DIED_FOR_GOOD, Said.ENDED_ITSELF)

TABLE: Final[Mapping[ContainerState, Mapping[ContainerInput, ContainerTransition]]] = {
    State.STOPPED: _row(
        State.STOPPED,
        {
            Said.START_REQUESTED: (State.STARTING, Do.SPAWN),
            Said.FAILED: (State.GAVE_UP, Do.REPORT_GAVE_UP),
        },
        {Said.STOP_REQUESTED, Said.RESTART_DUE, *_TALK, *_DEATH},
    ),
    State.STARTING: _row(
        State.STARTING,
        {
            Said.HELLO: (State.RUNNING, Do.LOAD_NODES),
            # The next start would speak the same version.
            Said.HELLO_MISMATCH: (State.GAVE_UP, Do.KILL, Do.REPORT_GAVE_UP),
            # Its death follows, and with it the decision about a restart.
            Said.HELLO_OVERDUE: (State.STARTING, Do.KILL),
            Said.CHANNEL_BROKEN: (State.STARTING, Do.KILL),
            Said.DIED_RESTART: (State.BACKOFF, Do.WAIT_FOR_RESTART),
            Said.DIED_FOR_GOOD: (State.GAVE_UP, Do.REPORT_GAVE_UP),
            Said.ENDED_ITSELF: (State.STOPPED,),
            Said.FAILED: (State.GAVE_UP, Do.REPORT_GAVE_UP),
            Said.STOP_REQUESTED: (State.STOPPING, Do.STOP_PROCESS),
        },
        # Its silence is measured by HELLO_OVERDUE.
        {Said.START_REQUESTED, Said.RESTART_DUE, Said.FROZEN},
    ),
    State.RUNNING: _row(
        State.RUNNING,
        {
            Said.CHANNEL_BROKEN: (State.RUNNING, Do.KILL),
            Said.FROZEN: (State.RUNNING, Do.KILL),
            Said.DIED_RESTART: (State.BACKOFF, Do.LOSE_NODES, Do.WAIT_FOR_RESTART),
            Said.DIED_FOR_GOOD: (State.GAVE_UP, Do.LOSE_NODES, Do.REPORT_GAVE_UP),
            Said.ENDED_ITSELF: (State.STOPPED, Do.LOSE_NODES),
            Said.STOP_REQUESTED: (State.STOPPING, Do.STOP_PROCESS),
            Said.FAILED: (State.GAVE_UP, Do.LOSE_NODES, Do.REPORT_GAVE_UP),
        },
        {
            Said.START_REQUESTED,
            Said.RESTART_DUE,
            # One hello for each process; a second one says nothing new.
            Said.HELLO,
            Said.HELLO_MISMATCH,
            Said.HELLO_OVERDUE,
        },
    ),
    State.BACKOFF: _row(
        State.BACKOFF,
        {
            Said.RESTART_DUE: (State.STARTING, Do.SPAWN),
            Said.STOP_REQUESTED: (State.STOPPED,),
            Said.FAILED: (State.GAVE_UP, Do.REPORT_GAVE_UP),
        },
        {Said.START_REQUESTED, *_TALK, *_DEATH},
    ),
    State.GAVE_UP: _row(
        State.GAVE_UP,
        {Said.START_REQUESTED: (State.STARTING, Do.SPAWN)},
        # It stays visible in the summary that it gave up.
        {Said.STOP_REQUESTED, Said.RESTART_DUE, Said.FAILED, *_TALK, *_DEATH},
    ),
    State.STOPPING: _row(
        State.STOPPING,
        {
            Said.DIED_RESTART: (State.STOPPED, Do.LOSE_NODES),
            Said.DIED_FOR_GOOD: (State.STOPPED, Do.LOSE_NODES),
            Said.ENDED_ITSELF: (State.STOPPED, Do.LOSE_NODES),
            Said.FAILED: (State.GAVE_UP, Do.LOSE_NODES, Do.REPORT_GAVE_UP),
        },
        {Said.START_REQUESTED, Said.STOP_REQUESTED, Said.RESTART_DUE, *_TALK},
    ),
}
