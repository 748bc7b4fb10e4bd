"""Watchdog of a container process: whether it still answers, and the failures that it counts."""

from __future__ import annotations

import asyncio
import logging
import math
from typing import TYPE_CHECKING, Final

import anyio

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
_ANSWERING: Final = frozenset({"control-read"})
"""Threads of a container that have to run for an answer, see control/channel.cpp."""
_REPORT_INTERVAL: Final = 10.0
"""Seconds between two reports of a count that grows."""


INTERVAL: Final = 1.0
"""Seconds between queries. Those of all containers fall together: the supervisor wakes up once."""
TIMEOUT: Final = 3.0
"""Seconds from a query to the verdict."""
LAST_PART: Final = 0.5
"""Seconds of the timeout in which the wait of both sides for a processor is measured."""
WANT: Final = 0.1
"""Seconds of waiting for a processor in that part from which on the timeout is extended."""
LONGEST: Final = 30.0
"""Seconds of extension after which a process that does not answer counts as frozen."""
LATENESS: Final = 0.5
"""Seconds of delay of a check from which on the supervisor itself was not running."""


def waits(pid: int) -> tuple[ProcessorWait, ProcessorWait]:
    """Return how long this thread, and the threads that answer, have waited for a processor."""
    return own_wait(), processor_wait(pid, _ANSWERING)


class ContainerWatch:
    """Watches one process of a container."""

    def __init__(self, container: str, send: Callable[[Outgoing], None], pid: int) -> None:
        """Watch nothing before `run`; ``send`` sends it a query, or nothing if it has exited."""
        self._container = container
        self._send = send
        self._pid = pid
        self._query_id = _FIRST_QUERY
        self._answered = anyio.Event()
        self._reported: dict[str, tuple[int, float]] = {}
        """By text: the count that was reported last, and when it may be reported again."""

    def accept(self, status: Status) -> bool:
        """Accept an answer; False if it answers another query than the watchdog's."""
        text = "%s: what %d of %d crashed nodes held stays until its end: cleaning up failed"
        self._report(text, status.leaked, status.crashes)
        text = "%s: %d of %d crashed nodes were killed; locks they held may remain locked"
        self._report(text, status.unquiesced, status.crashes)
        if status.query_id == self._query_id:
            self._answered.set()
        return status.query_id >= _FIRST_QUERY

    def _report(self, text: str, count: int, crashes: int) -> None:
        reported, again_at = self._reported.get(text, (0, -math.inf))
        now = asyncio.get_running_loop().time()
        if count > reported and now >= again_at:
            self._reported[text] = count, now + _REPORT_INTERVAL
            _log.warning(text, self._container, count, crashes)

    async def run(self) -> str:
        """Query it again and again; return why it counts as frozen."""
        is_answering = True
        while is_answering:
            await anyio.sleep(INTERVAL - anyio.current_time() % INTERVAL)
            self._query_id += 1
            self._answered = anyio.Event()
            self._send(Query(query_id=self._query_id, unique_ids=NO_NODE))
            is_answering = await self._answers()
        return f"it is frozen: no answer for {TIMEOUT:g} s"

    async def _answers(self) -> bool:
        """Wait for the answer; False when it takes too long.

        If the supervisor did not run for a while (stopped, or without a processor), the answer may
        be unread, so the timeout begins again. While many programs start on a machine, both sides
        wait for a processor for many seconds. As long as a debugger stops it, it has no timeout.
        """
        limit, suspected_at = TIMEOUT - LAST_PART, 0.0
        before: tuple[ProcessorWait, ProcessorWait] | None = None
        is_traced = False
        while True:
            due = anyio.current_time() + limit
            with anyio.move_on_after(limit):
                await self._answered.wait()
            if self._answered.is_set():
                if is_traced:
                    _log.warning("%s answers again", self._container)
                return True
            now = anyio.current_time()
            # Reads the counters of all threads, so only when an answer is overdue.
            both = waits(self._pid)
            if before is not None and both[1].is_traced and not is_traced:
                is_traced = True
                tracer = tracer_of(self._pid) or "a debugger"
                text = "%s does not answer: it is stopped by %s, which is no freeze; waiting for it"
                _log.warning(text, self._container, tracer)
            was_traced = before is not None and (both[1].is_traced or before[1].is_traced)
            if was_traced or now - due > LATENESS:
                limit, before = TIMEOUT - LAST_PART, None
                continue
            if before is None:
                suspected_at = now
            elif not _is_starved(before, both) or now - suspected_at >= LONGEST:
                return False
            else:
                _log.info("%s does not answer yet; processors are short", self._container)
            limit, before = LAST_PART, both


def _is_starved(
    before: tuple[ProcessorWait, ProcessorWait], now: tuple[ProcessorWait, ProcessorWait]
) -> bool:
    """Whether either side lacked a processor."""
    waited = [each.seconds - then.seconds for each, then in zip(now, before, strict=True)]
    return now[1].wants_one or max(waited) >= WANT
