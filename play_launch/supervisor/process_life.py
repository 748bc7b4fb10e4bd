"""Life of a container or an ordinary process: the table of phase and fact, and what causes facts.

Nothing here refers to what other units do; see `play_launch.supervisor.process_rules`.
"""

from __future__ import annotations

from enum import StrEnum, auto
from typing import TYPE_CHECKING, Final, NamedTuple, TypeAlias

from play_launch.supervisor.world import Phase

if TYPE_CHECKING:
    from collections.abc import Mapping


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


class Cell(NamedTuple):
    """An entry of the table."""

    phase: Phase
    actions: tuple[Action, ...] = ()


_Answers: TypeAlias = "Mapping[Fact, tuple[Phase, *tuple[Action, ...]]]"


def _row(phase: Phase, answers: _Answers) -> dict[Fact, Cell]:
    """Complete a row: a fact without an answer leaves the phase as it is."""
    row = {fact: Cell(then, tuple(actions)) for fact, (then, *actions) in answers.items()}
    return dict.fromkeys(Fact, Cell(phase)) | row


_EXITS: Final = (Fact.EXITED_RESTART, Fact.EXITED_GIVE_UP, Fact.EXITED_DONE)
_QUEUE: Final = (Phase.QUEUED,)
_KILL: Final = (Phase.KILLING, Action.KILL)
_STOP: Final = (Phase.STOPPING, Action.STOP)
_LIVES: Final[_Answers] = {
    Fact.EXITED_RESTART: (Phase.BACKOFF, Action.LOSE),
    Fact.EXITED_GIVE_UP: (Phase.GAVE_UP, Action.LOSE),
    Fact.EXITED_DONE: (Phase.STOPPED, Action.LOSE),
    Fact.STOP: _STOP,
    # What still runs of it is stopped in order.
    Fact.FAILED: (Phase.GAVE_UP, Action.LOSE, Action.STOP),
}

_TABLE: Final[Mapping[Phase, _Answers]] = {
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
TABLE: Final = {phase: _row(phase, answers) for phase, answers in _TABLE.items()}
