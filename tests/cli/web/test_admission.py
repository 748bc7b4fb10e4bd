"""Access to the page: by the real server, without a session where none is needed."""

from __future__ import annotations

import asyncio
import contextlib
import datetime as dt
import http.client
import os
import re
import ssl
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding, PrivateFormat
from cryptography.x509.oid import NameOID

from play_launch.cli.web.admission import Access, Rules
from tests.cli.web.server import SOCKET, Server, serving
from tests.support.loopback_network import permitted, wrapped
from tests.support.replay import COMMAND, run
from tests.support.waiting import until

HOSTS = frozenset({"robot"})
RULES = Rules(hosts=HOSTS, tokens=None, allows_acting=False, clients=1, is_secure=False)
SCOPE = {"type": "http", "headers": [(b"host", b"robot")], "path": "/", "server": ("", 80)}


@pytest.fixture(scope="module")
def free() -> Iterator[Server]:
    with serving() as server:
        until(lambda: answers(server), "the page")
        yield server


def answers(server: Server) -> bool:
    try:
        return server.status() in {200, 401}
    except OSError:
        return False


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({}, 200),
        ({"Host": "localhost"}, 200),
        ({"Host": "LOCALHOST:1"}, 200),
        ({"Host": "[::1]:80"}, 200),
        ({"Host": "192.0.2.7:80"}, 200),
        ({"Host": "evil.example"}, 421),
        ({"Host": "127.0.0.1.evil.example"}, 421),
        ({"Host": "127.0.0.1@evil.example"}, 421),
        ({"Host": "[::1"}, 421),
        ({"Host": ""}, 421),
        ({"Host": "localhost:1", "Origin": "http://localhost:1"}, 200),
        ({"Host": "localhost:1", "Origin": "http://localhost:2"}, 403),
        ({"Host": "localhost", "Origin": "http://evil.example"}, 403),
        ({"Host": "localhost", "Origin": "null"}, 403),
        ({"Host": "localhost", "Origin": "http://[::1"}, 403),
    ],
)
def test_names_and_origins(free: Server, headers: dict[str, str], status: int) -> None:
    assert free.status("/metrics", **headers) == status
    assert free.socket(**{"Host": "localhost", **headers}) == (101 if status == 200 else 403)


def test_the_page_may_not_be_framed_and_tells_nothing_about_itself(free: Server) -> None:
    _, headers, _ = free.get()
    assert headers["x-frame-options"] == "DENY"
    assert headers["x-content-type-options"] == "nosniff"
    assert "server" not in headers
    assert free.status("/docs") == free.status("/openapi.json") == 404


def test_without_a_token_nothing_is_shown(tmp_path: Path) -> None:
    kept = tmp_path / "tokens"
    with serving("--token-file", kept, "--allow-control", count=2) as server:
        until(lambda: answers(server), "the page")
        look, act = server.tokens
        assert kept.stat().st_mode & 0o777 == 0o600
        assert kept.read_text().split() == [look, act]
        for path in ("/", "/metrics", "/_nicegui/anything"):
            assert server.status(path) == 401
        assert server.socket() == 403
        status, headers, text = server.get(f"/?token={look}")
        assert status == 200
        assert 'content="0;url=/"' in text
        cookie = headers["set-cookie"]
        assert "HttpOnly" in cookie
        assert "SameSite=Strict" in cookie
        ours = cookie.partition(";")[0]
        assert server.status(Cookie=ours) == 200
        assert server.socket(Cookie=ours) == 101
        assert server.status("/metrics", Authorization=f"Bearer {look}") == 200
        assert "read only" in server.get(Cookie=ours)[2]
        assert "read only" not in server.get(Cookie=f"{ours.partition('=')[0]}={act}")[2]
        # Where the path leads to another server, the visitor stays here.
        assert 'url=/evil.example"' in server.get(f"//evil.example?token={look}")[2]
    with serving("--token-file", kept, "--allow-control") as again:
        until(lambda: answers(again), "the page")
        assert look not in again.invitations[0], "they are printed once"
        assert again.status(Cookie=f"play_launch_token_{again.port}={look}") == 200


def test_a_proxy_may_show_it_under_a_path(tmp_path: Path) -> None:
    words = ("--token-file", tmp_path / "tokens", "--root-path", "/robot", "--allow-host", "proxy")
    with serving(*words) as server:
        until(lambda: answers(server), "the page")
        assert "/robot/?token=" in server.invitations[0]
        (look,) = server.tokens
        _, headers, text = server.get(f"/?token={look}", Host="proxy")
        assert 'url=/robot/"' in text
        page = server.get(Cookie=headers["set-cookie"].partition(";")[0])[2]
        assert 'src="/robot/_nicegui/' in page


def test_it_speaks_tls(tmp_path: Path) -> None:
    key, certificate = tmp_path / "key.pem", tmp_path / "certificate.pem"
    own = ec.generate_private_key(ec.SECP256R1())
    key.write_bytes(
        own.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, serialization.NoEncryption())
    )
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "robot")])
    now = dt.datetime.now(dt.UTC)
    made = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(own.public_key())
        .serial_number(1)
        .not_valid_before(now - dt.timedelta(hours=1))
        .not_valid_after(now + dt.timedelta(hours=1))
        .sign(own, hashes.SHA256())
    )
    certificate.write_bytes(made.public_bytes(Encoding.PEM))
    words = ("--certificate", certificate, "--key", key, "--token-file", tmp_path / "tokens")
    with serving(*words) as server:
        assert server.url.startswith("https://")
        (look,) = server.tokens
        trusting = ssl.create_default_context(cafile=certificate)
        trusting.check_hostname = False

        def cookie() -> str:
            port = server.port
            link = http.client.HTTPSConnection("127.0.0.1", port, timeout=30, context=trusting)
            with contextlib.closing(link):
                link.request("GET", f"/?token={look}")
                return str(link.getresponse().headers["set-cookie"])

        assert cookie().endswith("; Secure")


def test_guessing_is_slow(tmp_path: Path) -> None:
    with serving("--token-file", tmp_path / "tokens") as server:
        until(lambda: answers(server), "the page")
        seen = [server.status(f"/?token=guess{number}") for number in range(15)]
        assert seen[0] == 401
        assert seen[-1] == 429
        # The right one is not held up.
        assert server.status(f"/?token={server.tokens[0]}") == 200


def test_a_token_file_that_others_can_read_is_refused(tmp_path: Path) -> None:
    kept = tmp_path / "tokens"
    kept.write_text("a" * 20 + "\n" + "b" * 20 + "\n")
    kept.chmod(0o644)
    assert f"chmod 600 {kept}" in run("web", "--token-file", kept, code=2).stderr
    kept.chmod(0o600)
    kept.write_text("short\nalso\n")
    assert "at least 16 characters" in run("web", "--token-file", kept, code=2).stderr
    assert "belong together" in run("web", "--key", kept, code=2).stderr
    assert "is not an IP address" in run("web", "--bind", "robot.local", code=2).stderr


@pytest.mark.parametrize("verb", [("web",), ("demo", "--web")])
@pytest.mark.parametrize("name", ["nicegui", "prometheus_client"])
def test_without_the_extra_it_says_how_to_get_it(
    verb: tuple[str, ...], name: str, tmp_path: Path
) -> None:
    (tmp_path / "sitecustomize.py").write_text(f"import sys; sys.modules[{name!r}] = None")
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    done = run(*verb, code=2, env=environment)
    assert f"needs {name}" in done.stderr
    assert "play-launch-py[web]" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.skipif(not permitted(), reason="this kernel permits no network namespace")
def test_other_addresses_demand_tokens() -> None:
    command = wrapped(COMMAND, "web", "--bind", "0.0.0.0", "--port", "0")
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert re.search(r":\d+/\?token=\S{32} \(to look\)", process.stdout.readline())
        process.terminate()


def test_there_are_limits() -> None:
    with serving() as server:
        until(lambda: answers(server), "the page")
        assert [server.socket() for _ in range(200)] == [101] * 20 + [403] * 180
        assert server.status() == 200
        server.open.pop(0).close()
        until(lambda: server.socket() == 101, "a place that is free again")


def test_pages_that_are_asked_for_and_never_opened_take_no_more_memory() -> None:
    with serving() as server:
        until(lambda: answers(server), "the page")
        assert {server.status("/nothing") for _ in range(30)} == {404}
        statuses = [server.status("/sessions" if number % 2 else "/") for number in range(60)]
        assert set(statuses[:15]) == {200}
        assert 503 in statuses[20:]
        assert server.status("/metrics") == 200
        until(lambda: answers(server), "the first ones to go")


def test_a_page_that_is_never_read_loses_its_place() -> None:
    with serving("--clients", "1") as server:
        until(lambda: answers(server), "the page")
        client = re.search(r"client_id\W+([\w-]+)", server.get()[2])
        assert client is not None
        page = f"&implicit_handshake=true&client_id={client[1]}&tab_id=t&document_id=d"
        assert server.socket(f"{SOCKET}{page}") == 101
        # Socket.IO's CONNECT in a frame: it is a page now, and would have to answer.
        server.open[-1].sock.sendall(b"\x81\x82" + bytes(4) + b"40")
        assert server.socket() == 403
        until(lambda: server.socket() == 101, "its place")


@pytest.mark.parametrize(("told", "is_error"), [("http.disconnect", False), ("http.request", True)])
def test_a_visitor_that_leaves_is_no_error(told: str, is_error: bool) -> None:
    async def page(scope: Any, receive: Any, send: Any) -> None:
        del scope, send
        await receive()
        raise RuntimeError("No response returned.")  # as Starlette's middleware does then

    async def receive() -> Any:
        return {"type": told}

    async def send(message: Any) -> None:
        raise AssertionError(message)

    visited = Access(page, RULES, {"/"}.__contains__)(dict(SCOPE), receive, send)
    with pytest.raises(RuntimeError) if is_error else contextlib.nullcontext():
        asyncio.run(visited)


def test_a_flood_of_requests_is_refused() -> None:
    seen: list[int] = []

    async def page(scope: Any, receive: Any, send: Any) -> None:
        del scope, receive
        await send({"type": "http.response.start", "status": 200})

    async def receive() -> Any:
        raise AssertionError

    async def send(message: Any) -> None:
        if message["type"] == "http.response.start":
            seen.append(message["status"])

    async def flood() -> None:
        access = Access(page, RULES, {"/"}.__contains__)
        for _ in range(2000):
            await access(dict(SCOPE), receive, send)

    asyncio.run(flood())
    assert set(seen[:600]) == {200}
    assert seen.count(429) > 1000
