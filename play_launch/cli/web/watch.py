"""What all open pages share: one connection to the session, only while a page is open."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections import deque
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import msgspec

from play_launch.cli import session_model as model
from play_launch.cli.session_link import POLL_INTERVAL, SessionLink
from play_launch.cli.web.metrics import Scrape
from play_launch.control.messages import UnitRow
from play_launch.control.protocol import Code, OperationError
from play_launch.control.sessions import NoSessionError, connect
from play_launch.control.units import Health, health, target_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from play_launch.cli.session_model import Confirmation
    from play_launch.control.client import ControlClient
    from play_launch.control.units import Target

_AGAIN: Final = 2.0
"""Seconds between two attempts to find a session."""
_LINGER: Final = 5.0
"""Seconds for which the connection is kept after the last page: it may just be loaded anew."""
_SHOWN_SILENCE: Final = 2.0
"""Seconds without an answer that are reported."""
_YOUNG: Final = 120_000_000_000
"""Nanoseconds in which a session comes up; a unit may wait, or be restarted, for hours."""
_HISTORY: Final = 60
"""Samples of the curve of a unit: a minute."""


class Watch:
    """One session as the pages show it. Belongs to the thread of the event loop.

    Attributes:
        name: Of the session, and its pid; empty before the first connection.
        problem: Why there is no connection; empty with one.
        changes: Grows with every change of rows and messages.
        lines: The last lines, each with a number from 1 on.
    """

    def __init__(self, session: str | None) -> None:
        self._session = session
        self.name = ""
        self.problem = "connecting"
        self.rows: list[UnitRow] = []
        self.changes = 0
        self.lines: deque[tuple[int, model.LogLine]] = deque(maxlen=model.LINES_LIMIT)
        self.last = model.RowLines()
        self.curves: dict[Target, deque[tuple[float, float]]] = {}
        self.missed = 0
        self._count = 0
        self._link: SessionLink | None = None
        self._client: ControlClient | None = None
        self._waiting: dict[int, Callable[[str], None]] = {}
        """By the identity of the request: two pages may ask for the same."""
        self._viewers = 0
        self._viewed = asyncio.Event()
        self._left_at = 0.0

    @property
    def complaint(self) -> str:
        """What is wrong with the connection at the moment; empty if nothing is."""
        silence = 0.0 if self._link is None else self._link.silence
        if self.problem or silence < _SHOWN_SILENCE:
            return self.problem
        return f"the session has not answered for {silence:.0f} s"

    @property
    def folder(self) -> str:
        """Of the session; raises OperationError without a connection."""
        if self._client is None:
            raise OperationError(Code.INTERNAL, self.problem)
        return self._client.hello.folder

    @property
    def bring_up(self) -> str:
        """Where it is shown how the system came up; without a connection, the list of sessions."""
        if self._client is None:
            return "/sessions"
        return f"/report/{Path(self._client.hello.folder).name}#bring-up-card"

    def comes_up(self, name: str) -> bool:
        """Return whether it is the session of that folder, is young, and units are on their way."""
        if self._client is None or Path(self._client.hello.folder).name != name:
            return False
        is_young = time.time_ns() - self._client.hello.started_ns < _YOUNG
        return is_young and any(health(row) is Health.CHANGING for row in self.rows)

    def enter(self) -> None:
        """A page is open."""
        self._viewers += 1
        self._viewed.set()

    def leave(self) -> None:
        self._viewers -= 1
        self._left_at = time.monotonic()

    async def run(self) -> None:
        """Keep the connection while pages are open, until cancelled."""
        try:
            while True:
                await self._viewed.wait()
                if self._link is None:
                    await self._connect()
                if self._link is not None:
                    self._link.poll()
                await asyncio.sleep(_AGAIN if self._link is None else POLL_INTERVAL)
                if not self._viewers and time.monotonic() - self._left_at > _LINGER:
                    self._viewed.clear()
                    self._disconnect("connecting")
        finally:
            self._disconnect("the server ends")

    async def _connect(self) -> None:
        try:
            client = await asyncio.to_thread(connect, self._session)
        except (NoSessionError, OperationError, OSError) as error:
            self._say(str(error))
            return
        self._client = client
        name = f"{client.hello.name} (pid {client.hello.pid})"
        if name != self.name:
            self.rows, self.curves, self.last = [], {}, model.RowLines()
        # The session sends its last lines again.
        self.lines.clear()
        self.name = name
        self._say("")
        self._link = SessionLink(client, self)

    def _disconnect(self, reason: str) -> None:
        if self._link is not None:
            self._link.close()
            self._link = None
        if self._client is not None:
            self._client.close()
            self._client = None
        for answer in self._waiting.values():
            answer(reason)
        self._waiting.clear()
        self._say(reason)

    def _say(self, problem: str) -> None:
        if problem != self.problem:
            self.problem = problem
            self.changes += 1

    async def status(self, target: Target) -> dict[str, Any]:
        """Ask for all about a unit, over a connection of its own; raises OperationError."""
        folder = self.folder

        def ask() -> Any:
            with connect(folder) as client:
                return client.ask("status", {"names": [str(target)]})

        try:
            rows = await asyncio.to_thread(ask)
        except (NoSessionError, OSError) as error:
            raise OperationError(Code.INTERNAL, str(error)) from None
        found: dict[str, Any] = rows[0]
        return found

    async def expectations(self) -> list[dict[str, Any]]:
        """Ask what is known of topics of which something is expected; raises OperationError."""
        folder = self.folder

        def ask() -> list[dict[str, Any]]:
            with connect(folder) as client:
                found: list[dict[str, Any]] = client.ask("expectations")
                return found

        try:
            return await asyncio.to_thread(ask)
        except (NoSessionError, OSError) as error:
            raise OperationError(Code.INTERNAL, str(error)) from None

    async def scrape(self) -> Scrape:
        """Ask for all of which there are metrics; it is empty without a session."""

        def ask() -> Scrape:
            with connect(self._session) as client:
                rows = msgspec.convert(client.ask("ps"), list[UnitRow], strict=False)
                more = map(client.ask, ("expectations", "recording", "system"))
                return Scrape(client.hello.name, rows, *more)

        try:
            return await asyncio.to_thread(ask)
        except (NoSessionError, OperationError, OSError):
            return Scrape("", [], [], {}, {})

    def carry_out(self, confirmed: Confirmation, answer: Callable[[str], None]) -> None:
        """Request an operation; ``answer`` gets the reason of a refusal, or an empty text."""
        if self._link is None:
            answer(self.problem)
            return
        try:
            self._link.carry_out(confirmed)
        except OperationError as error:
            answer(str(error))
        else:
            self._waiting[id(confirmed)] = answer

    # What the connection tells.

    def on_rows(self, rows: list[UnitRow]) -> None:
        self.rows = rows
        self.last.declare(rows)
        known = set(map(target_of, rows))
        self.curves = {target: curve for target, curve in self.curves.items() if target in known}
        for row in rows:
            curve = self.curves.setdefault(target_of(row), deque(maxlen=_HISTORY))
            curve.append((row.cpu_percent or 0.0, row.memory_bytes or 0.0))
        self.changes += 1

    def on_line(self, event: dict[str, Any]) -> None:
        with contextlib.suppress(KeyError, TypeError, ValueError):
            line = model.line_of(event)
            self._count += 1
            self.lines.append((self._count, line))
            self.last.add(line)

    def on_missed(self, count: int) -> None:
        self.missed += count

    def on_outcome(self, confirmed: Confirmation, reason: str) -> None:
        if (answer := self._waiting.pop(id(confirmed), None)) is not None:
            answer(reason)

    def on_end(self, reason: str) -> None:
        # Called by the link, which has stopped reading.
        asyncio.get_running_loop().call_soon(
            partial(self._disconnect, f"the session has ended: {reason}" if reason else "ended")
        )
