"""Why a unit is in a state, and what follows, as codes: its events have them."""

from __future__ import annotations

import signal
from enum import IntEnum
from typing import TYPE_CHECKING

from msgspec import Struct
from msgspec.structs import replace

from play_launch.supervisor.exit_code import ENDING_SIGNALS

if TYPE_CHECKING:
    from play_launch.supervisor.world import Exit


class Cause(IntEnum):
    """Why a unit is in a state: ``play_launch_msgs/StateEvent.cause``."""

    NOT_RECORDED = 0
    """The recording is of a version that wrote no causes."""
    NONE = 1
    SIGNAL = 2
    EXCEPTION = 3
    """An uncaught one."""
    EXIT_STATUS = 4
    """Other than 0."""
    UNKNOWN_STATUS = 5
    """It exited; another process read its exit status, or its parent was killed."""
    OUT_OF_MEMORY = 6
    STOPPED = 7
    """On request."""
    STOP_TIMEOUT = 8
    """It was requested to stop, and had to be killed."""
    FROZEN = 9
    """Killed by the supervisor: it did not answer."""
    CHANNEL_FAILED = 10
    """Killed by the supervisor: its control channel failed, or it sent no hello."""
    NODE_LEFT_LOCK = 11
    """Killed by the supervisor: a node of it exited with a lock that others wait for."""
    CONTAINER_EXITED = 12
    REFUSED = 13
    """Not started or loaded: its conditions cannot be met, or a load was fatal before."""


class Sequel(IntEnum):
    """What the supervisor does next: ``play_launch_msgs/StateEvent.sequel``."""

    NONE = 0
    RELOAD = 1
    RESTART = 2
    GAVE_UP = 3
    CONTAINER_RESTART = 4
    CONTAINER_STOP = 5
    SHUTDOWN = 6


class Outcome(Struct, frozen=True):
    """Why a unit is in a state, and what follows; the same fields are in its events."""

    cause: Cause = Cause.NONE
    sequel: Sequel = Sequel.NONE
    delay_ns: int = 0
    """Until the sequel."""
    culprit: str = ""
    """Key of the unit that caused it, where that is another one."""

    def followed_by(self, sequel: Sequel, delay: float = 0.0) -> Outcome:
        """Add a sequel, in so many seconds."""
        return replace(self, sequel=sequel, delay_ns=round(delay * 1e9))


def outcome_of(exit_: Exit, *, is_requested: bool) -> Outcome:
    """Give the cause of an exit that the supervisor did not force for another reason."""
    if exit_.signal == signal.SIGKILL and is_requested:
        return Outcome(Cause.STOP_TIMEOUT)
    if is_requested and (exit_.is_ok or exit_.signal in ENDING_SIGNALS):
        return Outcome(Cause.STOPPED)
    if exit_.is_lost:
        return Outcome(Cause.UNKNOWN_STATUS)
    if exit_.signal:
        return Outcome(Cause.SIGNAL)
    return Outcome(Cause.EXIT_STATUS if exit_.code else Cause.NONE)
