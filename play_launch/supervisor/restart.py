"""Restart decisions: whether, and after which delay, what exited is started again.

The number of restarts within a sliding window is limited, as by OTP's supervisors and systemd. The
delay grows exponentially and has a random part, so that processes that died together do not
restart at the same instant. A run that is longer than the window resets the delay.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from msgspec import Struct
from msgspec.structs import replace

if TYPE_CHECKING:
    from play_launch.config.model import RestartLimits

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


class RestartHistory(Struct, frozen=True, kw_only=True):
    """Restarts so far, as far as they count for the next decision."""

    recent: tuple[float, ...] = ()
    """When the restarts of the last window were due, in seconds, oldest first."""
    streak: int = 0
    """Restarts since the last run that was longer than the window."""
    total: int = 0


class Restart(Struct, frozen=True):
    """Start again after ``delay`` seconds."""

    delay: float


class GiveUp(Struct, frozen=True):
    """Do not start again."""

    reason: str


def decide(
    history: RestartHistory,
    bounds: RestartLimits,
    *,
    now: float,
    lived: float,
    jitter: float,
    counts: bool = True,
) -> tuple[RestartHistory, Restart | GiveUp]:
    """Decide about a death.

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
        return replace(history, recent=recent, streak=streak), GiveUp(reason)
    delay = _pause(bounds, streak) * (0.5 + 0.5 * jitter)
    if counts:
        recent = (*recent, now + delay)
    after = RestartHistory(recent=recent, streak=streak + 1, total=history.total + 1)
    return after, Restart(delay)


def _pause(bounds: RestartLimits, streak: int) -> float:
    """Give the full pause after that many restarts without a healthy life in between."""
    if bounds.first_at_once:
        if streak == 0:
            return 0.0
        streak -= 1
    return min(bounds.maximum, bounds.initial * 2.0 ** min(streak, _EXPONENT_LIMIT))
