"""Asks a session for what the screen shows, and has things done: one connection, never waiting."""

from __future__ import annotations

import asyncio
import time
from typing import TYPE_CHECKING, Any, Final, Protocol

from play_launch.cli.top.rows import Row, rows_of
from play_launch.control.protocol import Code, ControlError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from play_launch.cli.top.operations import Proposal
    from play_launch.control.client import ControlClient

PERIOD: Final = 1.0
"""Seconds between two looks at the rows; samples of CPU and memory come as often."""
_SOON: Final = 0.2
"""Seconds until a look after something has happened."""
MOST_UNDER_WAY: Final = 12
"""Operations at once; the session carries out 16 requests of a client, and two are ours."""
_LIMIT: Final = 60.0
_SPARE: Final = 10.0
"""Seconds that the answer may be later than the limit."""
_LINES: Final = ("output", "log")
_CHANGES: Final = frozenset({"node", "container", "process"})


class Watcher(Protocol):
    """Who is called when the session says something."""

    def on_rows(self, rows: Sequence[Row]) -> None:
        """See what there is by now."""

    def on_line(self, event: Mapping[str, Any]) -> None:
        """See a line of output or of the log."""

    def on_missed(self, events: int) -> None:
        """So many events were too many to send."""

    def on_outcome(self, proposal: Proposal, failure: str) -> None:
        """See what came of an operation; no failure: it is done."""

    def on_end(self, reason: str) -> None:
        """It says nothing any more; without a reason, because it closed the connection."""


class SessionLink:
    """The connection, while the event loop runs; `close` lets go of it."""

    def __init__(self, client: ControlClient, watcher: Watcher) -> None:
        """Use a client that nobody else uses."""
        self._client = client
        self._watcher = watcher
        self._loop = asyncio.get_running_loop()
        self._rows: int | None = None
        """Number of the request for rows that is not answered."""
        self._asked = 0.0
        self._events: int | None = None
        self._is_stale = False
        self._next: asyncio.TimerHandle | None = None
        self._under_way: dict[int, tuple[Proposal, asyncio.TimerHandle]] = {}
        self._is_open = False

    def begin(self) -> None:
        """Ask, and listen."""
        self._is_open = True
        self._loop.add_reader(self._client.fileno(), self._read)
        self._ask_for_rows()

    def close(self) -> None:
        """Stop asking and listening."""
        if not self._is_open:
            return
        self._is_open = False
        self._loop.remove_reader(self._client.fileno())
        if self._next is not None:
            self._next.cancel()
        for _, limit in self._under_way.values():
            limit.cancel()
        self._under_way.clear()

    @property
    def silence(self) -> float:
        """Seconds for which a question has not been answered; 0: all are."""
        return 0.0 if self._rows is None else time.monotonic() - self._asked

    def carry_out(self, proposal: Proposal) -> None:
        """Have something done; what comes of it is said later.

        Raises:
            ControlError: When too much is under way, or the session takes nothing.
        """
        if len(self._under_way) >= MOST_UNDER_WAY:
            raise ControlError(
                Code.REFUSED, f"{MOST_UNDER_WAY} operations are under way; ask again after one"
            )
        number = self._client.request(
            proposal.operation, {"names": [proposal.subject.target], "timeout": _LIMIT}
        )
        limit = self._loop.call_later(_LIMIT + _SPARE, self._give_up_on, number)
        self._under_way[number] = proposal, limit

    def _ask_for_rows(self) -> None:
        self._next = None
        self._is_stale = False
        try:
            self._rows = self._client.request("ps")
            self._asked = time.monotonic()
        except ControlError as error:
            self._end(str(error))

    def _follow(self) -> None:
        kinds = [*_LINES, *sorted(_CHANGES)]
        try:
            self._events = self._client.request("events", {"kinds": kinds, "follow": True})
        except ControlError as error:
            self._end(str(error))

    def _read(self) -> None:
        try:
            messages = self._client.arrived()
            for message in messages:
                self._take(message)
        except EOFError as error:
            self._end(str(error))
        except ControlError as error:
            self._end(str(error))
        except (KeyError, TypeError, ValueError) as error:
            self._end(f"what the session says is not understood: {error}")

    def _take(self, message: dict[str, Any]) -> None:
        number = message.get("id")
        failure = ControlError.of(message["error"]) if "error" in message else None
        if number is None and failure is not None:
            self._end(str(failure))
        elif number == self._rows:
            self._rows = None
            self._plan(_SOON if self._is_stale else PERIOD)
            if failure is None:
                self._watcher.on_rows(rows_of(message["result"]))
            if self._events is None:
                # What nodes wrote belongs to rows, so these come first.
                self._follow()
        elif number == self._events:
            self._take_event(message, failure)
        elif number in self._under_way:
            proposal, limit = self._under_way.pop(number)
            limit.cancel()
            self._watcher.on_outcome(proposal, "" if failure is None else str(failure))

    def _take_event(self, message: dict[str, Any], failure: ControlError | None) -> None:
        if failure is not None:
            self._end(str(failure))
        elif "missed" in message:
            self._watcher.on_missed(int(message["missed"]))
        elif "event" in message:
            event = message["event"]
            if event["event"] in _CHANGES:
                self._hurry()
            else:
                self._watcher.on_line(event)

    def _hurry(self) -> None:
        """Look at the rows again soon: something has changed."""
        if not self._is_stale:
            self._is_stale = True
            if self._rows is None:
                self._plan(_SOON)

    def _plan(self, seconds: float) -> None:
        if not self._is_open:
            return
        if self._next is not None:
            self._next.cancel()
        self._next = self._loop.call_later(seconds, self._ask_for_rows)

    def _give_up_on(self, number: int) -> None:
        proposal, _ = self._under_way.pop(number)
        self._watcher.on_outcome(proposal, "the session does not answer")

    def _end(self, reason: str) -> None:
        if self._is_open:
            self.close()
            self._watcher.on_end(reason)
