"""Clients that misbehave cost the others nothing; on a server whose answers are made up."""

from __future__ import annotations

import asyncio
import contextlib
import resource
import socket
import struct
import time
from collections.abc import AsyncIterator, Awaitable, Callable

import pytest

from play_launch.graph_daemon.http_server import HttpServer, ServerLimits

WAIT = 60.0
ANSWER = b"<answer/>"


def call(body: bytes = b"call", *, keep: bool = True) -> bytes:
    wish = b"" if keep else b"Connection: close\r\n"
    head = b"POST /ros2cli/ HTTP/1.1\r\n%bContent-Length: %d\r\n\r\n" % (wish, len(body))
    return head + body


class Clients:
    """A server, and clients of it."""

    def __init__(self, limits: ServerLimits, answer: Callable[[bytes], bytes | None]) -> None:
        listener = socket.socket()
        listener.bind(("127.0.0.1", 0))
        listener.listen(1024)
        self.port = listener.getsockname()[1]
        self.held_replies: list[Callable[[bytes], None]] = []
        self.server = HttpServer(listener, self._answer, limits)
        self._make = answer

    async def _answer(self, body: bytes) -> bytes:
        made = self._make(body)
        if made is not None:
            return made
        later: asyncio.Future[bytes] = asyncio.get_running_loop().create_future()
        self.held_replies.append(later.set_result)
        return await later

    async def connect(self) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        return await asyncio.open_connection("127.0.0.1", self.port)

    async def ask(self, body: bytes = b"call") -> float:
        """Ask as a good client does; returns the seconds that it took."""
        began = time.monotonic()
        reader, writer = await self.connect()
        writer.write(call(body, keep=False))
        assert (await read_answer(reader)).endswith(ANSWER)
        writer.close()
        with contextlib.suppress(ConnectionError):
            await writer.wait_closed()
        return time.monotonic() - began

    async def until(self, done: Callable[[], bool]) -> None:
        while not done():
            await asyncio.sleep(0.01)


async def read_answer(reader: asyncio.StreamReader) -> bytes:
    head = await reader.readuntil(b"\r\n\r\n")
    length = int(head.lower().partition(b"content-length:")[2].split()[0])
    return head + await reader.readexactly(length)


@contextlib.asynccontextmanager
async def serving(
    limits: ServerLimits | None = None, answer: Callable[[bytes], bytes | None] = lambda _: ANSWER
) -> AsyncIterator[Clients]:
    clients = Clients(limits or ServerLimits(), answer)
    clients.server.start()
    try:
        yield clients
    finally:
        await clients.server.close()
        assert clients.server.connections == 0
        assert clients.server.held == 0


def run(scenario: Callable[[], Awaitable[None]]) -> None:
    async def limited() -> None:
        await asyncio.wait_for(scenario(), WAIT)

    asyncio.run(limited())


async def was_reset(reader: asyncio.StreamReader) -> bool:
    """Whether a connection ends by a reset, which leaves no TIME_WAIT at our port."""
    try:
        while await reader.read(65536):
            pass
    except ConnectionResetError:
        return True
    return False


def test_a_late_answer_holds_back_the_next_request_of_its_client_only() -> None:
    async def scenario() -> None:
        def answer(body: bytes) -> bytes | None:
            return None if body == b"late" else ANSWER

        async with serving(answer=answer) as clients:
            reader, writer = await clients.connect()
            writer.write(call(b"late") + call())
            await clients.until(lambda: bool(clients.held_replies))
            await clients.ask()
            assert clients.server.requests == 1
            clients.held_replies[0](b"<late/>")
            assert (await read_answer(reader)).endswith(b"<late/>")
            assert (await read_answer(reader)).endswith(ANSWER)
            writer.close()

    run(scenario)


def test_an_answer_for_a_client_that_left_is_dropped() -> None:
    async def scenario() -> None:
        async with serving(ServerLimits(farewell=0.1), answer=lambda _: None) as clients:
            _, writer = await clients.connect()
            writer.write(call())
            await clients.until(lambda: bool(clients.held_replies))
            linger = struct.pack("ii", 1, 0)
            writer.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, linger)
            writer.close()
            clients.held_replies[0](ANSWER)
            await clients.until(lambda: clients.server.connections == 0)

    run(scenario)


@pytest.mark.parametrize(
    "beginning", [b"", b"POST /ros2", call()[:-1], b"GET / HTTP/1.1\r\n\r\n", call()]
)
def test_a_client_that_stands_still_is_reset_and_does_not_delay_others(beginning: bytes) -> None:
    async def scenario() -> None:
        async with serving(ServerLimits(deadline=0.5)) as clients:
            reader, writer = await clients.connect()
            writer.write(beginning)
            for _ in range(5):
                await clients.ask()
            assert await was_reset(reader)
            assert clients.server.resets == 1
            writer.close()

    run(scenario)


def test_a_client_that_sends_byte_by_byte_has_no_more_time_than_others() -> None:
    async def scenario() -> None:
        async with serving(ServerLimits(deadline=0.5)) as clients:
            reader, writer = await clients.connect()

            async def trickle() -> None:
                with contextlib.suppress(ConnectionError):
                    while True:
                        writer.write(b"x")
                        await writer.drain()
                        await asyncio.sleep(0.05)

            trickling = asyncio.create_task(trickle())
            assert await was_reset(reader)
            trickling.cancel()
            writer.close()

    run(scenario)


def test_a_client_that_never_reads_is_reset_and_its_answer_freed() -> None:
    answer = b"x" * 8_000_000

    async def scenario() -> None:
        def made(body: bytes) -> bytes:
            return answer if body == b"big" else ANSWER

        async with serving(ServerLimits(deadline=0.5), answer=made) as clients:
            _, writer = await clients.connect()
            writer.transport.pause_reading()  # type: ignore[attr-defined]
            writer.write(call(b"big") * 10)
            await clients.until(lambda: clients.server.held > 1_000_000)
            # One answer at a time is held for it.
            assert clients.server.held < 2 * len(answer)
            await clients.ask()
            await clients.until(lambda: clients.server.held == 0)
            writer.close()

    run(scenario)


@pytest.mark.parametrize("stream", [b"x" * 65536, call() * 500])
def test_a_client_that_sends_without_a_pause_does_not_delay_others(stream: bytes) -> None:
    def flood(port: int) -> None:
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port)) as client:
            client.setblocking(False)
            end = time.monotonic() + WAIT
            while time.monotonic() < end:
                for move in (lambda: client.send(stream), lambda: client.recv(1 << 20)):
                    with contextlib.suppress(BlockingIOError):
                        if not move():
                            return

    async def scenario() -> None:
        async with serving(ServerLimits(farewell=0.1)) as clients:
            flooding = asyncio.create_task(asyncio.to_thread(flood, clients.port))
            await clients.until(lambda: clients.server.requests > 0)
            for _ in range(5):
                await clients.ask()
            assert not flooding.done()
        await flooding

    run(scenario)


def test_a_defect_in_an_answer_resets_its_client_alone(caplog: pytest.LogCaptureFixture) -> None:
    def made(body: bytes) -> bytes:
        return ANSWER if body == b"call" else ANSWER[int(body)]  # type: ignore[return-value]

    async def scenario() -> None:
        async with serving(answer=made) as clients:
            reader, writer = await clients.connect()
            writer.write(call(b"none"))
            assert await was_reset(reader)
            await clients.ask()
            writer.close()

    run(scenario)
    assert "ValueError" in caplog.text


def test_clients_wait_while_no_descriptor_is_left(caplog: pytest.LogCaptureFixture) -> None:
    limit = resource.getrlimit(resource.RLIMIT_NOFILE)

    async def scenario() -> None:
        async with serving() as clients:
            waiting = [socket.create_connection(("127.0.0.1", clients.port)) for _ in range(3)]
            # The next one that is free is the first that may not be used.
            with socket.socket() as probe:
                free = probe.fileno()
            resource.setrlimit(resource.RLIMIT_NOFILE, (free, limit[1]))
            try:
                await clients.until(lambda: "not accepted" in caplog.text)
            finally:
                resource.setrlimit(resource.RLIMIT_NOFILE, limit)
            await clients.until(lambda: clients.server.connections == 3)
            await clients.ask()
            for client in waiting:
                client.close()

    run(scenario)
    assert caplog.text.count("not accepted") == 1


def test_what_is_held_for_all_clients_is_bounded() -> None:
    answer = b"x" * 8_000_000
    memory = 3 * len(answer)

    async def scenario() -> None:
        def made(body: bytes) -> bytes:
            return answer if body == b"big" else ANSWER

        async with serving(ServerLimits(deadline=30, memory=memory), answer=made) as clients:
            writers = []
            for _ in range(10):
                _, writer = await clients.connect()
                writer.transport.pause_reading()  # type: ignore[attr-defined]
                writer.write(call(b"big"))
                writers.append(writer)
            await clients.until(lambda: clients.server.resets >= 5)
            assert clients.server.held <= memory
            await clients.ask()
            for writer in writers:
                writer.transport.abort()

    run(scenario)


def test_where_there_are_too_many_the_one_without_progress_goes() -> None:
    async def scenario() -> None:
        async with serving(ServerLimits(connections=10)) as clients:
            silent = [await clients.connect() for _ in range(10)]
            await clients.until(lambda: clients.server.connections == 10)
            for _ in range(5):
                await clients.ask()
            assert clients.server.connections <= 10
            assert await was_reset(silent[0][0])
            # A client that was answered lately is kept longer.
            reader, writer = await clients.connect()
            writer.write(call())
            await read_answer(reader)
            more = [await clients.connect() for _ in range(5)]
            await clients.until(lambda: clients.server.resets >= 6)
            writer.write(call())
            assert (await read_answer(reader)).endswith(ANSWER)
            for _, other in [*silent, *more, (reader, writer)]:
                other.transport.abort()

    run(scenario)
