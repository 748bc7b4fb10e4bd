"""A connection to the control socket of a part: one request at a time."""

from __future__ import annotations

import asyncio
import logging
import shlex
import time
from typing import TYPE_CHECKING, Any, Final

from play_launch.control.protocol import (
    ANSWER_LIMIT,
    PROTOCOL,
    Code,
    OperationError,
    decode,
    encode,
)
from play_launch.deploy.machines.hosts import LinkLost, SessionGone

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Awaitable, Callable, Sequence

    from play_launch.deploy.machines.hosts import About, Host, Reader

_PIECE: Final = 64 * 1024
_HELLO: Final = 5.0
"""Seconds for the first message of a session."""
_SAMPLES: Final = 8
"""Measurements of a clock, of which the one with the shortest round trip counts."""
_NOTABLE_NS: Final = 1_000_000
"""A smaller change of an offset is not kept."""
_MOST_OFFSETS: Final = 1000

_log = logging.getLogger(__name__)


class Channel:
    """A connection that has read the session's hello."""

    def __init__(self, reader: Reader, writer: Any) -> None:
        self._reader = reader
        self._writer = writer
        self._lines: list[bytes] = []
        self._rest = bytearray()
        self.hello: dict[str, Any] = {}

    @classmethod
    async def open(cls, host: Host, link: str) -> Channel:
        """Connect to the session of a link.

        Raises LinkLost, SessionGone where no session listens, and OperationError.
        """
        channel = cls(*await host.open(f"{link}/control.sock"))
        first = await channel._next()
        if first is None:
            raise SessionGone
        if "error" in first:
            raise OperationError.of(first["error"])
        channel.hello = first["hello"]
        if channel.hello["protocol"] != PROTOCOL:
            raise OperationError(
                Code.PROTOCOL,
                f"play-launch {channel.hello['version']} there uses protocol "
                f"{channel.hello['protocol']}, and this one {PROTOCOL}: install the same version",
            )
        return channel

    async def ask(self, operation: str, arguments: object = None) -> Any:
        """Return the result of an operation; raises OperationError, LinkLost, SessionGone."""
        async for message in self.stream(operation, arguments):
            if "result" in message:
                return message["result"]
        raise SessionGone

    async def stream(
        self, operation: str, arguments: object = None, command: Sequence[str] = ()
    ) -> AsyncIterator[dict[str, Any]]:
        """Yield what answers a request up to its result; without one, the session has ended."""
        request = {"id": 1, "op": operation, "protocol": PROTOCOL, "arguments": arguments or {}}
        try:
            self._writer.write(encode({**request, "command": list(command)}))
            await self._writer.drain()
        except Exception as error:  # noqa: BLE001 - asyncssh has many
            raise LinkLost(str(error)) from None
        while (message := await self._next()) is not None:
            if "error" in message:
                raise OperationError.of(message["error"])
            yield message
            if "result" in message:
                return

    def close(self) -> None:
        self._writer.close()

    async def _next(self) -> dict[str, Any] | None:
        while not self._lines:
            try:
                data = await self._reader.read(_PIECE)
            except ConnectionResetError:  # it ended before it had read a request
                raise SessionGone from None
            except Exception as error:  # noqa: BLE001 - asyncssh has many
                raise LinkLost(str(error)) from None
            if not data:
                return None
            self._rest += data
            if len(self._rest) > ANSWER_LIMIT + _PIECE:
                raise OperationError(Code.TOO_LONG, f"a line is longer than {ANSWER_LIMIT} bytes")
            *self._lines, rest = bytes(self._rest).split(b"\n")
            self._rest = bytearray(rest)
        return decode(self._lines.pop(0))


async def links_of(host: Host, about: About) -> list[str]:
    """Return the links of the sessions of a machine, the latest first; raises LinkLost."""
    output = await host.run(f"ls -t {shlex.quote(about.links)} 2> /dev/null; true")
    return [f"{about.links}/{name}" for name in output.stdout.split() if name[0] != "."]


async def session_of(host: Host, about: About, machine: str, system: str) -> str:
    """Return the link of the session that runs a machine's part of a system; empty without one.

    Raises LinkLost.
    """
    for link in await links_of(host, about):
        try:
            async with asyncio.timeout(_HELLO):
                channel = await Channel.open(host, link)
        except (SessionGone, OperationError):
            continue
        except TimeoutError:
            # It may be the one, and must not be started twice.
            raise LinkLost("a session there does not answer") from None
        channel.close()
        if channel.hello.get("machine") == machine and channel.hello["name"] == system:
            return link
    return ""


class OtherClock:
    """How much the clocks of another machine are ahead of those of this one."""

    def __init__(self, machine: str, limit: float, recording_clock: Callable[[], int]) -> None:
        """Prepare; a system clock that is off by more than ``limit`` seconds is warned of.

        ``recording_clock`` gives the log time of the recording here, in ns.
        """
        self._machine = machine
        self._limit = limit
        self._recording_clock = recording_clock
        self._is_off = False
        self.offsets: list[tuple[int, int]] = []
        """Of the clock of its recording: a time of it, and by how much it was ahead then, in ns."""

    async def measure(self, connect: Callable[[], Awaitable[Channel]]) -> None:
        """Compare the clocks; raises LinkLost and OperationError."""
        samples = []
        channel = await connect()
        try:
            for _ in range(_SAMPLES):
                before, begun = time.time_ns(), self._recording_clock()
                there = await channel.ask("clock")
                trip = self._recording_clock() - begun
                ahead = there["stamp_ns"] - before - trip // 2
                recorded = there["recording_ns"]
                samples.append((trip, ahead, recorded, recorded - begun - trip // 2))
        finally:
            channel.close()
        trip, ahead, recorded, offset = min(samples)
        if not self.offsets or abs(offset - self.offsets[-1][1]) > max(_NOTABLE_NS, trip // 2):
            self.offsets.append((recorded, offset))
            if len(self.offsets) > _MOST_OFFSETS:
                del self.offsets[1:-1:2]
        was_off, self._is_off = self._is_off, abs(ahead) > self._limit * 1e9 + trip / 2
        if self._is_off and not was_off:
            _log.warning(
                "%s: its clock is %+.0f ms off (measured within %.1f ms); set it by chrony or NTP",
                self._machine,
                ahead / 1e6,
                trip / 2e6,
            )
        elif was_off and not self._is_off:
            _log.warning("%s: its clock is right now", self._machine)
