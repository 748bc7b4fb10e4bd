"""Watchdog of a container process, and the failures that it counts itself."""

from __future__ import annotations

import logging
from enum import StrEnum, auto
from typing import TYPE_CHECKING, Final

from msgspec import Struct

from play_launch.container.channel import ControlError
from play_launch.container.messages import NO_NODE, Query
from play_launch.process.identity import tracer_of
from play_launch.process.processor_wait import own_wait, processor_wait

if TYPE_CHECKING:
    from collections.abc import Callable

    from play_launch.container.messages import Outgoing, Status
    from play_launch.process.processor_wait import ProcessorWait

_log = logging.getLogger(__name__)

_FIRST_QUERY: Final = 1 << 63
"""Numbers of the watchdog's queries begin here, those of queries about nodes at 1."""
_ANSWERING: Final = frozenset({"control-read", "control-write"})
"""Threads of a container that have to run for an answer, see control/channel.cpp."""


def waits(pid: int) -> tuple[ProcessorWait, ProcessorWait]:
    """Return how long this thread, and the threads that answer, have waited for a processor."""
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
        self._leaked = Burst()
        self._unquiesced = Burst()

    def begin(self, send: Callable[[Outgoing], None], pid: int) -> None:
        """Watch a process that has just sent its hello."""
        self._send = send
        self._pid = pid
        self._noted = None
        self._is_traced = False
        self._watch = begin(self._clock(), self._limits)
        self._leaked, self._unquiesced = Burst(), Burst()

    def end(self) -> None:
        """Stop watching: the process exited, or is being stopped."""
        self._watch = None

    def accept(self, status: Status) -> bool:
        """Accept an answer; False if it answers another query than the watchdog's."""
        self._read_counts(status)
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
        """Do what is due; return why the process counts as frozen, empty if it does not."""
        if self._watch is None:
            return ""
        now = self._clock()
        # Reads the counters of all threads, so only when an answer is overdue.
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
                return f"it is frozen: no answer for {self._limits.timeout:g} s"
            case Verdict.WAIT:
                pass
        return ""

    def _look_at_threads(self, noted: tuple[ProcessorWait, ProcessorWait]) -> tuple[bool, bool]:
        """Return whether either side lacked a processor, and whether a debugger stopped it."""
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
            # The reader of the channel gets the same error and reports the container.
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
    """Time limits, in seconds."""

    interval: float = 1.0
    """From an answer to the next query."""
    timeout: float = 3.0
    """From a query to the verdict."""
    last_look: float = 0.5
    """Last part of the timeout, in which the wait of both sides for a processor is measured."""
    want: float = 0.1
    """Wait for a processor in that part from which on the timeout is extended."""
    longest: float = 30.0
    """Extension after which a process that does not answer counts as frozen."""
    lateness: float = 0.5
    """Delay of a check from which on the supervisor itself was not running."""


WATCH_LIMITS: Final = WatchLimits()


class Verdict(StrEnum):
    """Result of a check."""

    WAIT = auto()
    ASK = auto()
    """Send a query now."""
    SUSPECT = auto()
    """Note how long both sides have waited for a processor, for the next check."""
    FROZEN = auto()


class Watch(Struct, frozen=True, kw_only=True):
    """One process under watch."""

    due: float
    """When the next check is due."""
    asked_at: float | None = None
    """When the open query was sent; None without one."""
    suspected_at: float | None = None
    """Since when the waits for a processor are measured."""


def begin(now: float, limits: WatchLimits = WATCH_LIMITS) -> Watch:
    """Begin to watch a process that has just answered."""
    return Watch(due=now + limits.interval)


def answered(watch: Watch, now: float, limits: WatchLimits = WATCH_LIMITS) -> Watch:
    """Accept an answer; one to no open query changes nothing."""
    return watch if watch.asked_at is None else begin(now, limits)


def look(
    watch: Watch,
    now: float,
    limits: WatchLimits = WATCH_LIMITS,
    *,
    starved: bool = False,
    stopped: bool = False,
) -> tuple[Watch, Verdict]:
    """Check whether the answer is overdue.

    If the supervisor did not run for a while (stopped, or without a processor), the answer may be
    unread, so the timeout begins again. While many programs start on a machine, both sides wait for
    a processor for many seconds.

    Args:
        watch: State since the last check.
        now: Seconds of the loop's clock.
        limits: Time limits.
        starved: Whether that was so since the last check, which was SUSPECT.
        stopped: Whether a debugger stopped the process since then: the timeout begins again.
    """
    if now < watch.due:
        return watch, Verdict.WAIT
    first_wait = limits.timeout - limits.last_look
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
"""Seconds without growth after which a burst has ended."""


class Burst(Struct):
    """Bursts of a counter that only grows. Times are seconds of a monotonic clock."""

    quiet: float = QUIET
    count: int = 0
    _reported: int = 0
    _grew_at: float | None = None
    """When the counter grew last in the current burst; None without one."""

    def see(self, count: int, now: float) -> bool:
        """Accept the current value; return whether it is to be reported."""
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
