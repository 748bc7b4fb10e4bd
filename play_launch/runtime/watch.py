"""Watchdog of a container process: whether it still answers, and the failures that it counts."""

from __future__ import annotations

import logging
import math
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
_REPORT_INTERVAL: Final = 10.0
"""Seconds between two reports of a count that grows."""


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
        self._is_traced = False
        self._reported: dict[str, tuple[int, float]] = {}
        """By text: the count that was reported last, and when it may be reported again."""
        self._reset(None)

    def _reset(self, due: float | None) -> None:
        self.due = due
        """When `on_time` has to be called next; None when nothing is due."""
        self._is_open = False
        """Whether a query is not answered yet."""
        self._suspected_at: float | None = None
        """Since when the waits for a processor are measured."""
        self._noted: tuple[ProcessorWait, ProcessorWait] | None = None

    def begin(self, send: Callable[[Outgoing], None], pid: int) -> None:
        """Watch a process that has just sent its hello."""
        self._send = send
        self._pid = pid
        self._is_traced, self._reported = False, {}
        self._reset(self._clock() + self._limits.interval)

    def end(self) -> None:
        """Stop watching: the process exited, or is being stopped."""
        self._reset(None)

    def accept(self, status: Status) -> bool:
        """Accept an answer; False if it answers another query than the watchdog's."""
        text = "%s: what %d of %d crashed nodes held stays until its end: cleaning up failed"
        self._report(text, status.leaked, status.crashes)
        text = "%s: %d of %d crashed nodes were killed; locks they held may remain locked"
        self._report(text, status.unquiesced, status.crashes)
        if status.query_id < _FIRST_QUERY:
            return False
        if self._is_open and status.query_id == self._query_id:
            if self._is_traced:
                self._is_traced = False
                _log.warning("%s answers again", self._container)
            self._reset(self._clock() + self._limits.interval)
        return True

    def _report(self, text: str, count: int, crashes: int) -> None:
        reported, again_at = self._reported.get(text, (0, -math.inf))
        now = self._clock()
        if count > reported and now >= again_at:
            self._reported[text] = count, now + _REPORT_INTERVAL
            _log.warning(text, self._container, count, crashes)

    def on_time(self) -> str:
        """Do what is due; return why the process counts as frozen, empty if it does not.

        If the supervisor did not run for a while (stopped, or without a processor), the answer may
        be unread, so the timeout begins again. While many programs start on a machine, both sides
        wait for a processor for many seconds.
        """
        now, limits = self._clock(), self._limits
        if self.due is None or now < self.due:
            return ""
        if not self._is_open:
            self._is_open, self.due = True, now + limits.timeout - limits.last_look
            self._query()
            return ""
        # Reads the counters of all threads, so only when an answer is overdue.
        starved, stopped = self._look_at_threads()
        if stopped or now - self.due > limits.lateness:
            self._reset(now + limits.timeout - limits.last_look)
            self._is_open = True
        elif self._suspected_at is None or (starved and now - self._suspected_at < limits.longest):
            if starved:
                _log.info("%s does not answer yet; processors are short", self._container)
            if self._suspected_at is None:
                self._suspected_at = now
            self._noted, self.due = waits(self._pid), now + limits.last_look
        else:
            self._reset(None)
            return f"it is frozen: no answer for {limits.timeout:g} s"
        return ""

    def _look_at_threads(self) -> tuple[bool, bool]:
        """Return whether either side lacked a processor, and whether a debugger stopped it."""
        if self._noted is None:
            return False, False
        both = waits(self._pid)
        waited = [now.seconds - then.seconds for now, then in zip(both, self._noted, strict=True)]
        stopped = both[1].is_traced or self._noted[1].is_traced
        if both[1].is_traced and not self._is_traced:
            self._is_traced = True
            tracer = tracer_of(self._pid) or "a debugger"
            text = "%s does not answer: it is stopped by %s, which is no freeze; waiting for it"
            _log.warning(text, self._container, tracer)
        return both[1].wants_one or max(waited) >= self._limits.want, stopped

    def _query(self) -> None:
        assert self._send is not None
        self._query_id += 1
        try:
            self._send(Query(query_id=self._query_id, unique_ids=NO_NODE))
        except ControlError as error:
            # The reader of the channel gets the same error and reports the container.
            _log.debug("%s: a question was not sent: %s", self._container, error)
