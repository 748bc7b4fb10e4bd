"""One connection to the session: rows, events and operations, without blocking the loop."""

from __future__ import annotations

import asyncio
import time
from typing import TYPE_CHECKING, Any, Final

import msgspec

from play_launch.control.messages import UnitRow
from play_launch.control.protocol import OperationError

if TYPE_CHECKING:
    from typing import Protocol

    from play_launch.cli.session_model import Confirmation
    from play_launch.control.client import ControlClient

    class Screen(Protocol):
        """What the session tells goes there: the terminal's screen, or the pages."""

        def on_rows(self, rows: list[UnitRow]) -> None: ...
        def on_line(self, event: dict[str, Any]) -> None: ...
        def on_missed(self, count: int, /) -> None: ...
        def on_outcome(self, done: Confirmation, failure: str, /) -> None: ...
        def on_end(self, reason: str) -> None: ...


POLL_INTERVAL: Final = 0.2
"""Seconds between two calls of `SessionLink.poll`, and from a change to a request for rows."""
_INTERVAL: Final = 1.0
"""Seconds between two requests for rows; samples of CPU and memory have the same interval."""
_LINES: Final = ("output", "log")
_CHANGES: Final = ("container", "node", "process")


class SessionLink:
    """The connection; `close` stops reading it."""

    def __init__(self, client: ControlClient, screen: Screen) -> None:
        self._client = client
        self._screen = screen
        self._rows: int | None = None
        """Number of the pending request for rows."""
        self._requested_at = 0.0
        self._events: int | None = None
        self._is_stale = False
        self._pending: dict[int, Confirmation] = {}
        asyncio.get_running_loop().add_reader(client.fileno(), self._read)
        self.poll()

    def close(self) -> None:
        asyncio.get_running_loop().remove_reader(self._client.fileno())

    @property
    def silence(self) -> float:
        """Seconds for which the pending request for rows is unanswered; 0 without one."""
        return 0.0 if self._rows is None else time.monotonic() - self._requested_at

    def poll(self) -> None:
        is_old = time.monotonic() - self._requested_at >= _INTERVAL
        if self._rows is not None or not (self._is_stale or is_old):
            return
        self._is_stale = False
        self._requested_at = time.monotonic()
        try:
            self._rows = self._client.request("ps")
        except OperationError as error:
            self._end(str(error))

    def carry_out(self, confirmed: Confirmation) -> None:
        """Request an operation; raises OperationError. The outcome goes to the screen."""
        names = [str(confirmed.target)]
        self._pending[self._client.request(confirmed.operation, {"names": names})] = confirmed

    def _read(self) -> None:
        try:
            for message in self._client.arrived():
                self._receive(message)
        except (EOFError, OperationError) as error:
            self._end(str(error))
        except (KeyError, TypeError, ValueError) as error:
            self._end(f"the answer of the session is not understood: {error}")

    def _receive(self, message: dict[str, Any]) -> None:
        number = message.get("id")
        failure = OperationError.of(message["error"]) if "error" in message else None
        if number in self._pending:
            self._screen.on_outcome(self._pending.pop(number), str(failure or ""))
        elif number == self._rows:
            self._rows = None
            if failure is None:
                self._screen.on_rows(
                    msgspec.convert(message["result"], list[UnitRow], strict=False)
                )
            if self._events is None:
                # Lines are assigned to rows, so rows are requested first.
                kinds = [*_LINES, *_CHANGES]
                self._events = self._client.request("events", {"kinds": kinds, "follow": True})
        elif failure is not None:
            raise failure
        elif "missed" in message:
            self._screen.on_missed(int(message["missed"]))
        elif "event" in message:
            event = message["event"]
            if event["event"] in _LINES:
                self._screen.on_line(event)
            else:
                self._is_stale = True

    def _end(self, reason: str) -> None:
        self.close()
        self._screen.on_end(reason)
