"""Whether a process that is asked something every now and then still answers.

There is never more than one open question, so nothing piles up at a process that is frozen. Times
are seconds of any monotonic clock and are passed in.
"""

from __future__ import annotations

from enum import StrEnum, auto
from typing import Final

from msgspec import Struct


class WatchLimits(Struct, frozen=True, kw_only=True):
    """Seconds."""

    interval: float = 1.0
    """From an answer to the next question."""
    patience: float = 3.0
    """From a question to the verdict."""
    last_look: float = 0.5
    """The end of the patience, in which both sides are watched for want of a processor."""
    want: float = 0.1
    """Of that time, spent waiting for a processor: silence means nothing then."""
    longest: float = 30.0
    """Who still does not answer after so many seconds of that is given up all the same."""
    lateness: float = 0.5
    """A look that comes later than this says more about us than about the other side."""


WATCH_LIMITS: Final = WatchLimits()


class Verdict(StrEnum):
    """What a look at the clock says."""

    WAIT = auto()
    ASK = auto()
    """Put a question now."""
    SUSPECT = auto()
    """Note how long both sides have waited for a processor so far; the next look wants to know."""
    FROZEN = auto()


class Watch(Struct, frozen=True, kw_only=True):
    """One process under watch."""

    due: float
    """When to look again."""
    asked_at: float | None = None
    """When the open question was put; None without one."""
    suspected_at: float | None = None
    """Since when it is watched whether the two sides get a processor."""


def begin(now: float, limits: WatchLimits = WATCH_LIMITS) -> Watch:
    """Begin to watch a process that has just shown that it lives."""
    return Watch(due=now + limits.interval)


def answered(watch: Watch, now: float, limits: WatchLimits = WATCH_LIMITS) -> Watch:
    """Take an answer; one to no open question changes nothing."""
    return watch if watch.asked_at is None else begin(now, limits)


def look(
    watch: Watch,
    now: float,
    limits: WatchLimits = WATCH_LIMITS,
    *,
    starved: bool = False,
    stopped: bool = False,
) -> tuple[Watch, Verdict]:
    """Look at the clock.

    When we ourselves did not run for a while (stopped, or starved of CPU time), an answer may be
    waiting for us; so the other side gets its time once more. A machine on which a hundred programs
    start keeps both sides waiting for a processor turn by turn, for many seconds: ``starved`` says
    that this was so since the look before, which was SUSPECT. ``stopped`` says that a debugger
    stopped the process since then: it gets the time after that, however long it takes.
    """
    if now < watch.due:
        return watch, Verdict.WAIT
    first_wait = limits.patience - limits.last_look
    if watch.asked_at is None:
        return Watch(due=now + first_wait, asked_at=now), Verdict.ASK
    if stopped or now - watch.due > limits.lateness:
        return Watch(due=now + first_wait, asked_at=watch.asked_at), Verdict.WAIT
    since = now if watch.suspected_at is None else watch.suspected_at
    if watch.suspected_at is None or (starved and now - since < limits.longest):
        due = now + limits.last_look
        return Watch(due=due, asked_at=watch.asked_at, suspected_at=since), Verdict.SUSPECT
    return watch, Verdict.FROZEN
