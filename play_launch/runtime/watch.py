"""Notices that a container process is frozen, and what it counts of its own troubles."""

from __future__ import annotations

import logging
from enum import StrEnum, auto
from typing import TYPE_CHECKING, Final

from msgspec import Struct

from play_launch.process.identity import tracer_of
from play_launch.process.processor_wait import own_wait, processor_wait
from play_launch.wire.channel import ControlError
from play_launch.wire.messages import NO_NODE, Query

if TYPE_CHECKING:
    from collections.abc import Callable

    from play_launch.process.processor_wait import ProcessorWait
    from play_launch.wire.messages import Outgoing, Status

_log = logging.getLogger(__name__)

_FIRST_QUERY: Final = 1 << 63
"""Our questions are counted from here on, those about nodes from 1."""
_ANSWERING: Final = frozenset({"control-read", "control-write"})
"""Threads of a container that have to run for an answer, see control/channel.cpp."""


def waits(pid: int) -> tuple[ProcessorWait, ProcessorWait]:
    """Say how long we, and what answers in that process, have waited for a processor so far."""
    return own_wait(), processor_wait(pid, _ANSWERING)


class ContainerWatch:
    """Watches one container process after the other; times are seconds of the loop's clock."""

    def __init__(self, container: str, *, clock: Callable[[], float], limits: WatchLimits) -> None:
        """Watch nothing yet."""
        self._container = container
        self._clock = clock
        self._limits = limits
        self._query_id = _FIRST_QUERY
        self._send: Callable[[Outgoing], None] | None = None
        self._pid = 0
        self._watch: Watch | None = None
        self._noted: tuple[ProcessorWait, ProcessorWait] | None = None
        self._is_traced = False
        self._leaked = Episode()
        self._unquiesced = Episode()
        self._dead_locks: tuple[str, ...] = ()

    @property
    def may_hold_dead_locks(self) -> bool:
        """Whether a node died so suddenly that a lock may stay locked for ever."""
        return self._unquiesced.count > 0

    @property
    def probably_holds_dead_locks(self) -> bool:
        """Whether, besides, cleaning up after a node failed: what waits for such a lock does."""
        return self.may_hold_dead_locks and self._leaked.count > 0

    @property
    def waits_for_the_dead(self) -> str:
        """What is known to wait for ever for a lock that a dead node holds; empty: nothing."""
        more = len(self._dead_locks) - 1
        return (self._dead_locks[0] + (f" (and {more} more)" if more else "")) if more >= 0 else ""

    def begin(self, send: Callable[[Outgoing], None], pid: int) -> None:
        """Watch a process that has just said hello."""
        self._send = send
        self._pid = pid
        self._noted = None
        self._is_traced = False
        self._watch = begin(self._clock(), self._limits)
        self._leaked, self._unquiesced = Episode(), Episode()
        self._dead_locks = ()

    def end(self) -> None:
        """The process ends, or is being stopped: silence means nothing any more."""
        self._watch = None

    def hear(self, status: Status) -> bool:
        """Take an answer; False when it is none to us."""
        self._read_counts(status)
        self._dead_locks = status.dead_locks
        if status.query_id < _FIRST_QUERY:
            return False
        if self._watch is not None and status.query_id == self._query_id:
            if self._is_traced:
                self._is_traced = False
                _log.warning("%s answers again", self._container)
            self._watch = answered(self._watch, self._clock(), self._limits)
        return True

    def next_deadline(self) -> float | None:
        """When `on_time` has to be called next; None when nothing is due."""
        return None if self._watch is None else self._watch.due

    def on_time(self) -> str:
        """Do what is due; why the process counts as frozen, empty as long as it does not."""
        if self._watch is None:
            return ""
        now = self._clock()
        # Reading what the kernel counted takes a look at all threads: only for who is suspected.
        starved = stopped = False
        if self._noted is not None and now >= self._watch.due:
            starved, stopped = self._look_at_threads(self._noted)
        if stopped:
            self._noted = None
        self._watch, verdict = look(
            self._watch, now, self._limits, starved=starved, stopped=stopped
        )
        match verdict:
            case Verdict.ASK:
                self._noted = None
                self._ask()
            case Verdict.SUSPECT:
                if starved:
                    _log.info("%s does not answer yet; processors are short", self._container)
                self._noted = waits(self._pid)
            case Verdict.FROZEN:
                self._watch = None
                return f"it is frozen: no answer for {self._limits.patience:g} s"
            case Verdict.WAIT:
                pass
        return ""

    def _look_at_threads(self, noted: tuple[ProcessorWait, ProcessorWait]) -> tuple[bool, bool]:
        """Say whether either side wanted a processor, and whether a debugger stopped the other."""
        both = waits(self._pid)
        waited = [now.seconds - then.seconds for now, then in zip(both, noted, strict=True)]
        stopped = both[1].is_traced or noted[1].is_traced
        if both[1].is_traced and not self._is_traced:
            self._is_traced = True
            tracer = tracer_of(self._pid) or "a debugger"
            text = "%s does not answer: it is stopped by %s, which is no freeze; waiting for it"
            _log.warning(text, self._container, tracer)
        return both[1].wants_one or max(waited) >= self._limits.want, stopped

    def _ask(self) -> None:
        assert self._send is not None
        self._query_id += 1
        try:
            self._send(Query(query_id=self._query_id, unique_ids=NO_NODE))
        except ControlError as error:
            # Whoever reads the channel learns it as well and deals with the container.
            _log.debug("%s: a question was not sent: %s", self._container, error)

    def _read_counts(self, status: Status) -> None:
        now = self._clock()
        if self._leaked.see(status.leaked, now):
            _log.warning(
                "%s: what %d of %d crashed nodes held stays until its end: cleaning up failed",
                self._container,
                status.leaked,
                status.crashes,
            )
        if self._unquiesced.see(status.unquiesced, now):
            _log.warning(
                "%s: %d of %d crashed nodes were killed; locks they held may remain locked",
                self._container,
                status.unquiesced,
                status.crashes,
            )


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


QUIET = 10.0
"""Seconds without growth after which a burst counts as over."""


class Episode(Struct):
    """One number that only grows. Times are seconds of any monotonic clock and are passed in."""

    quiet: float = QUIET
    count: int = 0
    _reported: int = 0
    _grew_at: float | None = None
    """Of the burst that goes on; None without one."""

    def see(self, count: int, now: float) -> bool:
        """Take the number as it is now; return whether it is to be reported."""
        if count > self.count:
            self.count = count
            began = self._grew_at is None
            self._grew_at = now
            return began and self._report()
        if self._grew_at is not None and now - self._grew_at >= self.quiet:
            self._grew_at = None
            return self.count > self._reported and self._report()
        return False

    def _report(self) -> bool:
        self._reported = self.count
        return True
