"""Server on the control socket of a session; the event loop's thread only."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import sys
from functools import partial
from typing import TYPE_CHECKING, Any, Final

import msgspec

from play_launch.control.messages import Caller, Request, SessionHello, read_request
from play_launch.control.protocol import ANSWER_LIMIT, REQUEST_LIMIT, Code, OperationError, encode
from play_launch.control.registration import peer_of

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Awaitable, Callable

    from play_launch.control.registration import ControlSocket

    Operate = Callable[[Request, Caller], Awaitable[object]]
    """Carries a request out and returns its result; raises OperationError."""

CLIENTS_LIMIT: Final = 128
"""Connections at the same time; further ones are refused."""
REQUESTS_LIMIT: Final = 16
"""Requests of one client that are under way; further ones wait in its socket."""
_UNREAD_LIMIT: Final = 1024 * 1024
"""Bytes that wait for a client to read them; then its requests and streams wait."""
_log = logging.getLogger(__name__)


@contextlib.asynccontextmanager
async def serving(
    socket: ControlSocket, hello: SessionHello, operate: Operate
) -> AsyncIterator[None]:
    """Serve clients while the block runs; it runs in any case."""
    for problem in socket.problems:
        _log.warning("%s", problem)
    if socket.socket is None:
        yield
        return
    # The path of the socket goes by a descriptor that may be another file's by now.
    options: dict[str, Any] = {"cleanup_socket": False} if sys.version_info >= (3, 13) else {}
    server = ControlServer(hello, operate)
    async with asyncio.TaskGroup() as tasks:
        listener = await asyncio.start_unix_server(
            lambda reader, writer: server.accept(tasks, reader, writer),
            sock=socket.socket,
            limit=REQUEST_LIMIT,
            **options,
        )
        try:
            yield
        finally:
            await asyncio.to_thread(socket.withdraw)
            listener.close()
            await server.close()


class ControlServer:
    """Serves the clients of a session."""

    def __init__(self, hello: SessionHello, operate: Operate) -> None:
        self._hello = encode({"hello": msgspec.to_builtins(hello)})
        self._operate = operate
        self._clients: dict[asyncio.Task[None], asyncio.StreamWriter] = {}

    def accept(
        self,
        tasks: asyncio.TaskGroup,
        reader: asyncio.StreamReader,
        writer: asyncio.StreamWriter,
    ) -> None:
        task = tasks.create_task(self._serve(reader, writer))
        self._clients[task] = writer
        task.add_done_callback(self._clients.pop)

    async def close(self) -> None:
        """Disconnect all clients; answers that are written are still sent."""
        writers = tuple(self._clients.values())
        tasks = tuple(self._clients)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        for writer in writers:
            writer.transport.abort()  # one that does not read

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.transport.set_write_buffer_limits(high=_UNREAD_LIMIT)
        slots = asyncio.Semaphore(REQUESTS_LIMIT)
        try:
            pid, uid, _ = peer_of(writer.get_extra_info("socket"))
            self._refuse_others(uid)
            writer.write(self._hello)
            async with asyncio.TaskGroup() as tasks:
                while line := await _line(reader):
                    request = read_request(line)
                    await slots.acquire()
                    caller = Caller(pid, uid, request.command, partial(_send, writer, request.id))
                    task = tasks.create_task(self._carry_out(request, caller, writer))
                    task.add_done_callback(lambda _: slots.release())
                raise ConnectionResetError  # noqa: TRY301 - ends its requests
        except* OperationError as refused:
            error = refused.exceptions[0]
            assert isinstance(error, OperationError)
            writer.write(encode({"id": None, "error": error.as_object()}))
        except* OSError:
            pass  # of this connection
        except* Exception:  # noqa: BLE001 - the others are served on
            _log.exception("a client's connection failed")
        finally:
            writer.close()

    def _refuse_others(self, uid: int) -> None:
        if uid not in {0, os.geteuid()}:
            text = f"this session is of user {os.geteuid()}, and you are user {uid}"
            raise OperationError(Code.NOT_ALLOWED, text)
        if len(self._clients) > CLIENTS_LIMIT:
            text = f"{CLIENTS_LIMIT} clients are connected already"
            raise OperationError(Code.NOT_ALLOWED, text)

    async def _carry_out(
        self, request: Request, caller: Caller, writer: asyncio.StreamWriter
    ) -> None:
        try:
            result = await self._operate(request, caller)
            line = encode({"id": request.id, "result": result}, msgspec.to_builtins)
            if len(line) > ANSWER_LIMIT:
                raise OperationError(Code.TOO_LONG, "the answer is too long; name fewer units")  # noqa: TRY301
        except OperationError as error:
            line = _error(request, error)
        except ConnectionError:
            raise
        except Exception as error:  # noqa: BLE001 - it is logged, and the run goes on
            _log.exception("the control request %r failed", request.op)
            line = _error(
                request, OperationError(Code.INTERNAL, f"{type(error).__name__}: {error}")
            )
        await _write(writer, line)


async def _line(reader: asyncio.StreamReader) -> bytes:
    """Read a line; empty at the end of the connection. Raises OperationError."""
    while True:
        try:
            line = await reader.readline()
        except ValueError:
            text = f"a line is longer than {REQUEST_LIMIT} bytes"
            raise OperationError(Code.TOO_LONG, text) from None
        if not line.endswith(b"\n"):
            return b""
        if line.strip():
            return line


async def _send(writer: asyncio.StreamWriter, number: int, kind: str, value: object) -> None:
    await _write(writer, encode({"id": number, kind: value}, msgspec.to_builtins))


async def _write(writer: asyncio.StreamWriter, line: bytes) -> None:
    """Write a line when the client has read most of the earlier ones; raises ConnectionError."""
    writer.write(line)
    await writer.drain()
    await asyncio.sleep(0)  # other tasks run, also when a lot is sent


def _error(request: Request, error: OperationError) -> bytes:
    return encode({"id": request.id, "error": error.as_object()}, msgspec.to_builtins)
