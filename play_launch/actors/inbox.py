"""One inbox and one timer: whatever is done to a member is done through here, one after the other.

Why it is carried out at once, and not by a task: docs/decisions/member-inbox.md.
"""

from __future__ import annotations

import asyncio
from collections import deque
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable


class Inbox:
    """Belongs to the thread of the event loop; times are seconds of its clock."""

    def __init__(
        self,
        *,
        deadlines: Callable[[], Iterable[float | None]],
        on_time: Callable[[], None],
        on_error: Callable[[Exception], None],
    ) -> None:
        """Take what is asked after each piece of work: when `on_time` is due (None: not).

        `on_error` gets what a piece of work raises, and must not raise itself.
        """
        self._loop = asyncio.get_running_loop()
        self._deadlines = deadlines
        self._on_time = on_time
        self._on_error = on_error
        self.on_settled: Callable[[], None] = lambda: None
        """Called when nothing is left to be done for now."""
        self._waiting: deque[Callable[[], None]] = deque()
        self._is_busy = False
        self._is_closed = False
        self._timer: asyncio.TimerHandle | None = None

    def deliver(self, work: Callable[[], None]) -> None:
        """Do something at once, or after what is being done."""
        self._waiting.append(work)
        if self._is_busy:
            return
        self._is_busy = True
        try:
            while self._waiting:
                try:
                    self._waiting.popleft()()
                except Exception as error:  # noqa: BLE001 - others are not to pay for it
                    self._on_error(error)
        finally:
            self._is_busy = False
        self._set_timer()
        self.on_settled()

    def close(self) -> None:
        """Do nothing at any later time."""
        self._is_closed = True
        if self._timer is not None:
            self._timer.cancel()

    def lateness(self) -> float:
        """Give the seconds since when `on_time` is due; 0 if it is not.

        More than the loop itself is late by, and nobody is going to call it.
        """
        due = self._due()
        return 0.0 if due is None or self._is_closed else max(0.0, self._loop.time() - due)

    def _due(self) -> float | None:
        return min((at for at in self._deadlines() if at is not None), default=None)

    def _set_timer(self) -> None:
        """See to it that `on_time` is called in time; too early does no harm."""
        due = self._due()
        if due is None or self._is_closed:
            return
        if self._timer is not None:
            if self._timer.when() <= due:
                return
            self._timer.cancel()
        self._timer = self._loop.call_at(due, self._timer_is_over)

    def _timer_is_over(self) -> None:
        self._timer = None
        self.deliver(self._on_time)
