"""One connection to the session: rows, events and operations, without blocking the loop."""

from __future__ import annotations

import asyncio
import time
from typing import TYPE_CHECKING, Any, Final

from play_launch.cli.top.rows import rows_of
from play_launch.control.protocol import Code, OperationError

if TYPE_CHECKING:
    from play_launch.cli.top.app import TopApp
    from play_launch.cli.top.rows import Confirmation
    from play_launch.control.client import ControlClient

INTERVAL: Final = 1.0
"""Seconds between two requests for rows; samples of CPU and memory have the same interval."""
_INTERVAL_AFTER_CHANGE: Final = 0.2
"""Seconds from a change to the next request for rows."""
OPERATIONS_LIMIT: Final = 12
"""Concurrent operations; the session accepts 16 requests of a client."""
_TIMEOUT: Final = 60.0
_GRACE: Final = 10.0
"""Seconds for the answer after the timeout of the operation."""
_LINES: Final = ("output", "log")
_CHANGES: Final = frozenset({"node", "container", "process"})


class SessionLink:
    """The connection; `close` stops reading it."""

    def __init__(self, client: ControlClient, app: TopApp) -> None:
        self._client = client
        self._app = app
        self._loop = asyncio.get_running_loop()
        self._rows: int | None = None
        """Number of the pending request for rows."""
        self._requested_at = 0.0
        self._events: int | None = None
        self._is_stale = False
        self._next: asyncio.TimerHandle | None = None
        self._pending: dict[int, tuple[Confirmation, asyncio.TimerHandle]] = {}
        self._is_open = False

    def begin(self) -> None:
        """Start requesting and reading."""
        self._is_open = True
        self._loop.add_reader(self._client.fileno(), self._read)
        self._request_rows()

    def close(self) -> None:
        """Stop requesting and reading."""
        if not self._is_open:
            return
        self._is_open = False
        self._loop.remove_reader(self._client.fileno())
        if self._next is not None:
            self._next.cancel()
        for _, limit in self._pending.values():
            limit.cancel()
        self._pending.clear()

    @property
    def silence(self) -> float:
        """Seconds for which the pending request for rows is unanswered; 0 without one."""
        return 0.0 if self._rows is None else time.monotonic() - self._requested_at

    def carry_out(self, confirmed: Confirmation) -> None:
        """Request an operation; raises OperationError. The outcome goes to the application."""
        if len(self._pending) >= OPERATIONS_LIMIT:
            raise OperationError(
                Code.REFUSED,
                f"{OPERATIONS_LIMIT} operations are pending; repeat it when one is done",
            )
        number = self._client.request(
            confirmed.operation, {"names": [confirmed.subject.target], "timeout": _TIMEOUT}
        )
        limit = self._loop.call_later(_TIMEOUT + _GRACE, self._time_out, number)
        self._pending[number] = confirmed, limit

    def _request_rows(self) -> None:
        self._next = None
        self._is_stale = False
        try:
            self._rows = self._client.request("ps")
            self._requested_at = time.monotonic()
        except OperationError as error:
            self._end(str(error))

    def _follow(self) -> None:
        kinds = [*_LINES, *sorted(_CHANGES)]
        try:
            self._events = self._client.request("events", {"kinds": kinds, "follow": True})
        except OperationError as error:
            self._end(str(error))

    def _read(self) -> None:
        try:
            messages = self._client.arrived()
            for message in messages:
                self._receive(message)
        except EOFError as error:
            self._end(str(error))
        except OperationError as error:
            self._end(str(error))
        except (KeyError, TypeError, ValueError) as error:
            self._end(f"the answer of the session is not understood: {error}")

    def _receive(self, message: dict[str, Any]) -> None:
        number = message.get("id")
        failure = OperationError.of(message["error"]) if "error" in message else None
        if number is None and failure is not None:
            self._end(str(failure))
        elif number == self._rows:
            self._rows = None
            self._schedule(_INTERVAL_AFTER_CHANGE if self._is_stale else INTERVAL)
            if failure is None:
                self._app.on_rows(rows_of(message["result"]))
            if self._events is None:
                # Lines are assigned to rows, so rows are requested first.
                self._follow()
        elif number == self._events:
            self._receive_event(message, failure)
        elif number in self._pending:
            confirmed, limit = self._pending.pop(number)
            limit.cancel()
            self._app.on_outcome(confirmed, "" if failure is None else str(failure))

    def _receive_event(self, message: dict[str, Any], failure: OperationError | None) -> None:
        if failure is not None:
            self._end(str(failure))
        elif "missed" in message:
            self._app.on_missed(int(message["missed"]))
        elif "event" in message:
            event = message["event"]
            if event["event"] in _CHANGES:
                self._refresh_soon()
            else:
                self._app.on_line(event)

    def _refresh_soon(self) -> None:
        """Request rows soon, after a change."""
        if not self._is_stale:
            self._is_stale = True
            if self._rows is None:
                self._schedule(_INTERVAL_AFTER_CHANGE)

    def _schedule(self, seconds: float) -> None:
        if not self._is_open:
            return
        if self._next is not None:
            self._next.cancel()
        self._next = self._loop.call_later(seconds, self._request_rows)

    def _time_out(self, number: int) -> None:
        confirmed, _ = self._pending.pop(number)
        self._app.on_outcome(confirmed, "the session does not answer")

    def _end(self, reason: str) -> None:
        if self._is_open:
            self.close()
            self._app.on_end(reason)
