"""The server against clients of every kind; the event loop is watched for being blocked."""

from __future__ import annotations

import asyncio
import contextlib
import fcntl
import json
import os
import select
import socket
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any
from unittest.mock import Mock

import pytest

from play_launch.control import server
from play_launch.control.messages import SessionHello
from play_launch.control.protocol import REQUEST_LIMIT, Code, OperationError, decode, encode
from play_launch.control.registration import LINKS, ControlSocket, registered
from play_launch.control.server import CLIENTS_LIMIT, REQUESTS_LIMIT, serving
from play_launch.control.sessions import NoSessionError, connect, connect_to
from play_launch.recording.folder import CONTROL_SOCKET
from tests.control.links import put_link

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable

    from play_launch.control.messages import Caller, Request


def hello(folder: Path) -> SessionHello:
    return SessionHello(
        version="0.1.0",
        pid=os.getpid(),
        name="robot",
        session="6c1f",
        folder=str(folder),
        started_ns=7,
    )


class Session:
    """Something that can be asked, and counts what is under way."""

    def __init__(self) -> None:
        self.under_way = 0
        self.most = 0
        self.callers: list[Caller] = []

    async def __call__(self, request: Request, caller: Caller) -> object:
        self.under_way += 1
        self.most = max(self.most, self.under_way)
        self.callers.append(caller)
        try:
            return await self._do(request, caller)
        finally:
            self.under_way -= 1

    async def _do(self, request: Request, caller: Caller) -> object:
        arguments = json.loads(bytes(request.arguments))
        match request.op:
            case "echo":
                return arguments
            case "count":
                for number in range(arguments["to"]):
                    await caller.send("event", number)
                return "counted"
            case "flood":
                while True:
                    await caller.send("event", "x" * 1000)
                    await asyncio.sleep(0)
            case "wait":
                await asyncio.Event().wait()
            case "fail":
                raise ValueError("of our own")
            case "large":
                return "x" * 17_000_000
        raise OperationError(Code.UNKNOWN_OPERATION, "no")


@pytest.fixture(autouse=True)
def links(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "links"
    monkeypatch.setenv(LINKS, str(folder))
    return folder


@contextlib.asynccontextmanager
async def served(folder: Path) -> AsyncIterator[Session]:
    folder.mkdir(parents=True, exist_ok=True)
    session = Session()
    with contextlib.closing(await asyncio.to_thread(ControlSocket, str(folder))) as door:
        async with serving(door, hello(folder), session):
            yield session


def with_server(folder: Path, work: Callable[[Session], Any]) -> Any:
    """Run a blocking function beside a server."""

    async def main() -> Any:
        async with served(folder) as session, asyncio.timeout(60):
            return await asyncio.to_thread(work, session)

    return asyncio.run(main())


def until_queued(door: ControlSocket) -> None:
    assert door.socket is not None
    waiting = select.poll()
    waiting.register(door.socket, select.POLLIN)
    assert waiting.poll(60_000)


def test_an_early_client_waits_until_the_server_accepts(tmp_path: Path) -> None:
    async def main() -> None:
        with contextlib.closing(await asyncio.to_thread(ControlSocket, str(tmp_path))) as door:
            early = asyncio.create_task(asyncio.to_thread(connect))
            await asyncio.to_thread(until_queued, door)
            assert not early.done()
            async with serving(door, hello(tmp_path), Session()), asyncio.timeout(60):
                with await early as client:
                    assert await asyncio.to_thread(client.ask, "echo", {"a": 1}) == {"a": 1}

    asyncio.run(main())


def test_it_answers_where_the_descriptor_of_its_address_leads_elsewhere_by_now(
    tmp_path: Path,
) -> None:
    async def main() -> None:
        with (
            Path(os.devnull).open() as other,
            contextlib.closing(ControlSocket(str(tmp_path))) as door,
        ):
            assert door.socket is not None
            used = int(door.socket.getsockname().split("/")[4])
            reused = fcntl.fcntl(other, fcntl.F_DUPFD_CLOEXEC, used)
            try:
                assert reused == used
                async with serving(door, hello(tmp_path), Session()), asyncio.timeout(60):
                    with await asyncio.to_thread(connect) as client:
                        assert await asyncio.to_thread(client.ask, "echo", {"a": 1}) == {"a": 1}
            finally:
                os.close(reused)

    asyncio.run(main())


def test_a_client_of_a_run_that_ends_before_it_answers_is_told(tmp_path: Path, links: Path) -> None:
    with ThreadPoolExecutor(1) as pool:
        with contextlib.closing(ControlSocket(str(tmp_path))) as door:
            early = pool.submit(connect)
            until_queued(door)
        with pytest.raises(NoSessionError, match="has just ended"):
            early.result(60)
    assert not list(tmp_path.glob("*.sock"))
    assert not list(links.iterdir())


def test_it_greets_answers_and_is_gone_at_its_end(tmp_path: Path, links: Path) -> None:
    def talk(session: Session) -> None:
        with connect() as client:
            assert (client.hello.name, client.hello.folder) == ("robot", str(tmp_path))
            assert client.hello.pid == os.getpid()
            assert client.ask("echo", {"names": ["ä", 1.5]}) == {"names": ["ä", 1.5]}
            assert session.callers[0][:2] == (os.getpid(), os.geteuid())
            counted = [
                message["event"]
                for message in client.stream("count", {"to": 3})
                if "event" in message
            ]
            assert counted == [0, 1, 2]
        status = (tmp_path / CONTROL_SOCKET).stat()
        assert status.st_mode & 0o777 == 0o600
        assert [link.folder for link in registered()] == [str(tmp_path)]

    with_server(tmp_path, talk)
    assert not (tmp_path / CONTROL_SOCKET).exists()
    assert not registered()
    with pytest.raises(NoSessionError, match="no session of yours is running"):
        connect()


def test_errors_are_errors_and_the_connection_goes_on(tmp_path: Path) -> None:
    def talk(_: Session) -> None:
        with connect_to(str(tmp_path)) as client:
            for operation, code in (
                ("nonsense", Code.UNKNOWN_OPERATION),
                ("fail", Code.INTERNAL),
                ("large", Code.TOO_LONG),
            ):
                with pytest.raises(OperationError) as refused:
                    client.ask(operation)
                assert refused.value.code == code
            assert client.ask("echo", {"still": "here"}) == {"still": "here"}

    with_server(tmp_path, talk)


@pytest.mark.parametrize(
    ("sent", "code"),
    [
        (b"GET / HTTP/1.1\r\n\r\n", Code.MALFORMED),
        (b"\0\xff" * 500 + b"\n", Code.MALFORMED),
        (b"x" * (REQUEST_LIMIT + 1), Code.TOO_LONG),
        (b'{"id": 1, "op": "ps", "protocol": 99}\n', Code.PROTOCOL),
    ],
)
def test_garbage_is_answered_and_ends_the_connection(
    sent: bytes, code: str, tmp_path: Path
) -> None:
    def talk(_: Session) -> None:
        with connected(tmp_path) as plain, plain.makefile("rb") as lines:
            lines.readline()
            plain.sendall(sent)
            answer = decode(lines.readline())
            assert (answer["id"], answer["error"]["code"]) == (None, code)
            with contextlib.suppress(ConnectionResetError):
                assert lines.read() == b""
        with connect() as client:
            assert client.ask("echo") == {}

    with_server(tmp_path, talk)


def test_more_clients_than_there_may_be_are_refused_and_the_rest_served(tmp_path: Path) -> None:
    def talk(_: Session) -> None:
        clients = [connect_to(str(tmp_path)) for _ in range(CLIENTS_LIMIT)]
        with pytest.raises(OperationError) as refused:
            connect_to(str(tmp_path))
        assert refused.value.code == Code.NOT_ALLOWED
        assert clients[-1].ask("echo") == {}
        for client in clients:
            client.close()
        with connect_to(str(tmp_path)) as client:
            assert client.ask("echo") == {}

    with_server(tmp_path, talk)


def test_a_client_that_never_reads_makes_nothing_grow(tmp_path: Path) -> None:
    def talk(session: Session) -> None:
        with connected(tmp_path) as deaf:
            deaf.sendall(encode({"id": 1, "op": "flood"}))
            # The server stops reading when its answers are not read.
            deaf.setblocking(False)
            with contextlib.suppress(BlockingIOError):
                for number in range(100_000):
                    deaf.sendall(
                        encode({"id": number, "op": "echo", "arguments": {"x": "y" * 500}})
                    )
                pytest.fail("all of it was read")
            assert session.most <= REQUESTS_LIMIT + 1
            with connect() as client:
                assert client.ask("echo", {"a": 1}) == {"a": 1}

    with_server(tmp_path, talk)


def test_a_client_that_disappears_ends_what_it_asked_for(tmp_path: Path) -> None:
    def talk(session: Session) -> None:
        with connect() as other:
            gone = connect_to(str(tmp_path))
            gone._connection.sendall(encode({"id": 1, "op": "wait"}))
            gone._connection.sendall(encode({"id": 2, "op": "flood"}))
            while session.under_way < 2:
                other.ask("echo")
            gone.close()
            while session.under_way:
                other.ask("echo")

    with_server(tmp_path, talk)


@pytest.mark.parametrize("error", [OSError(105, "no buffer space"), RuntimeError("of our own")])
def test_a_connection_that_fails_ends_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    def talk(_: Session) -> None:
        with connect_to(str(tmp_path)) as earlier:
            with monkeypatch.context() as patch:
                patch.setattr(server, "peer_of", Mock(side_effect=error))
                with pytest.raises((NoSessionError, ConnectionError)):
                    connect_to(str(tmp_path))
            assert earlier.ask("echo", {"a": 1}) == {"a": 1}
        with connect_to(str(tmp_path)) as later:
            assert later.ask("echo", {"a": 2}) == {"a": 2}

    with_server(tmp_path, talk)


def test_a_request_in_pieces_is_one(tmp_path: Path) -> None:
    def talk(_: Session) -> None:
        with connected(tmp_path) as plain, plain.makefile("rb") as lines:
            lines.readline()
            for byte in encode({"id": 5, "op": "echo", "arguments": {"a": "é"}}):
                plain.sendall(bytes([byte]))
            assert decode(lines.readline()) == {"id": 5, "result": {"a": "é"}}

    with_server(tmp_path, talk)


def test_a_folder_with_a_long_path(tmp_path: Path) -> None:
    folder = tmp_path.joinpath(*["a-folder-with-a-name-of-some-length"] * 8)
    assert len(str(folder)) > 250

    def talk(_: Session) -> None:
        with connect_to(str(folder)) as client:
            assert client.ask("echo") == {}
        with connect() as client:
            assert client.hello.folder == str(folder)

    with_server(folder, talk)


@pytest.mark.skipif(os.geteuid() != 0, reason="needs root to become another user")
def test_another_user_is_refused_even_where_the_mode_of_the_file_permits_it(tmp_path: Path) -> None:
    for folder in (tmp_path, *tmp_path.parents):
        if folder.stat().st_uid == os.geteuid():
            folder.chmod(folder.stat().st_mode | 0o055)

    def ask_as_another_user(path: str) -> bytes:
        ours, theirs = os.pipe()
        child = os.fork()
        if child == 0:
            try:
                os.setgroups([])
                os.setgid(65534)
                os.setuid(65534)
                asking = socket.socket(socket.AF_UNIX)
                try:
                    asking.connect(path)
                    os.write(theirs, asking.recv(10_000))
                except OSError as error:
                    os.write(theirs, str(error.errno).encode())
            finally:
                os._exit(0)
        os.close(theirs)
        with os.fdopen(ours, "rb") as answer:
            said = answer.read()
        os.waitpid(child, 0)
        return said

    def talk(session: Session) -> None:
        path = os.path.relpath(tmp_path / CONTROL_SOCKET)
        assert ask_as_another_user(path) == b"13"  # EACCES: the mode of the socket
        (tmp_path / CONTROL_SOCKET).chmod(0o666)
        answer = decode(ask_as_another_user(path).strip())
        assert answer["error"]["code"] == Code.NOT_ALLOWED
        assert "you are user 65534" in answer["error"]["message"]
        assert not session.callers

    with_server(tmp_path, talk)


def test_of_several_sessions_one_has_to_be_chosen(tmp_path: Path) -> None:
    async def main() -> None:
        async with served(tmp_path / "a"), served(tmp_path / "b"):
            await asyncio.to_thread(talk)

    def talk() -> None:
        # Both are of this process, so there is one link only: add the other one by hand.
        put_link(Path(os.environ[LINKS]), 1, tmp_path / "a")
        with pytest.raises(NoSessionError, match="2 sessions are running; choose one") as refused:
            connect()
        assert str(tmp_path / "a") in str(refused.value)
        for named, folder in ((str(tmp_path / "a"), "a"), ("b", "b"), ("1", "a")):
            with connect(named) as client:
                assert client.hello.folder == str(tmp_path / folder)
        with pytest.raises(NoSessionError, match="2 sessions are called robot"):
            connect("robot")
        with pytest.raises(NoSessionError, match="there is no session nothing"):
            connect("nothing")

    asyncio.run(main())


def test_something_else_on_the_socket_is_no_session(tmp_path: Path) -> None:
    listening = socket.socket(socket.AF_UNIX)
    listening.bind(os.path.relpath(tmp_path / CONTROL_SOCKET))
    listening.listen()

    async def main() -> None:
        async def talk(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            writer.write(b"220 mail.example.org ESMTP\r\n")
            await writer.drain()
            writer.close()

        async with await asyncio.start_unix_server(talk, sock=listening):
            with pytest.raises(OperationError):
                await asyncio.to_thread(connect_to, str(tmp_path))

    asyncio.run(main())


@contextlib.contextmanager
def connected(folder: Path) -> Any:
    plain = socket.socket(socket.AF_UNIX)
    with plain:
        plain.settimeout(30)
        plain.connect(os.path.relpath(folder / CONTROL_SOCKET))
        yield plain
