"""Outcomes as codes: causes of states and what follows; decisions about restarts.

The number of restarts within a sliding window is limited, as by OTP's supervisors and systemd. The
delay grows exponentially and has a random part, so that processes that died together do not
restart at the same instant. A run that is longer than the window resets the delay.
"""

from __future__ import annotations

import signal
from enum import IntEnum
from typing import TYPE_CHECKING, Final

from msgspec import Struct
from msgspec.structs import replace

if TYPE_CHECKING:
    from play_launch.config.model import RestartLimits
    from play_launch.supervisor.world import Exit


BLOCKED_AFTER: Final = 10.0
_EXPONENT_LIMIT: Final = 60

PERMANENT_EXIT_CODES: Final = {
    64: "its arguments were not understood",
    125: "its supervisor was gone when it started",
    126: "its program cannot be executed",
    127: "its program was not found",
}
"""Exit codes (sysexits, shells, spawn_guard) that the next start would only repeat."""

CONTEXT_EXIT_CODE: Final = 79
"""Of a container whose nodes share one process, when one of them shut the ROS context down."""
ENDING_SIGNALS: Final = frozenset({signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGKILL})
"""Signals of a stop, by the supervisor or an operator: an exit by one of them is no crash."""


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
    BLOCKED = 14
    """It is loaded; its executor has been in one callback for `BLOCKED_AFTER` seconds."""
    RETURNED = 15
    """Its executor has left that callback."""


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


def outcome_of(exit_: Exit, *, is_requested: bool, may_end: bool) -> Outcome:
    """Give the cause of an exit that the supervisor did not force for another reason.

    A process ``may_end`` with status 0; a container never is done.
    """
    if exit_.signal == signal.SIGKILL and is_requested:
        return Outcome(Cause.STOP_TIMEOUT)
    if is_requested and (exit_.is_ok or exit_.signal in ENDING_SIGNALS):
        return Outcome(Cause.STOPPED)
    if exit_.is_lost:
        return Outcome(Cause.UNKNOWN_STATUS)
    if exit_.signal:
        return Outcome(Cause.SIGNAL)
    return Outcome(Cause.NONE if may_end and exit_.is_ok else Cause.EXIT_STATUS)


def described(what: str, reason: str) -> str:
    return f"{what}: {reason}" if reason else what


class RestartHistory(Struct, frozen=True, kw_only=True):
    """Restarts so far, as far as they count for the next decision."""

    recent: tuple[float, ...] = ()
    """When the restarts of the last window were due, in seconds, oldest first."""
    streak: int = 0
    """Restarts since the last run that was longer than the window."""
    total: int = 0


def decide(
    history: RestartHistory,
    bounds: RestartLimits,
    *,
    now: float,
    lived: float,
    jitter: float,
    counts: bool = True,
) -> tuple[RestartHistory, float | str]:
    """Decide after how many seconds a unit that died starts again, or why it does not.

    Args:
        history: What was decided before.
        bounds: The limits.
        now: Time of the death, seconds of a monotonic clock.
        lived: How long it was ready before it died, in seconds; 0 when it never was.
        jitter: A random number in [0, 1); the pause is between half and all of its length.
        counts: Whether the restart uses up one of ``max_restarts``. One that does not comes even
            when they are used up, unless restarting is switched off.
    """
    recent = tuple(due for due in history.recent if now - due < bounds.within)
    streak = 0 if lived >= bounds.within else history.streak
    if len(recent) >= bounds.max_restarts and (counts or bounds.max_restarts == 0):
        times = f"restart limit reached ({len(recent)} in {bounds.within:g} s)"
        reason = times if recent else "restarting is switched off"
        return replace(history, recent=recent, streak=streak), reason
    if bounds.first_at_once and streak == 0:
        full = 0.0
    else:
        exponent = min(streak - bounds.first_at_once, _EXPONENT_LIMIT)
        full = min(bounds.maximum, bounds.initial * 2.0**exponent)
    delay = full * (0.5 + 0.5 * jitter)
    if counts:
        recent = (*recent, now + delay)
    after = RestartHistory(recent=recent, streak=streak + 1, total=history.total + 1)
    return after, delay
