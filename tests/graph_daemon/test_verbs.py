"""``play-launch node | topic | service``: output, and the exit codes."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any
from xmlrpc.client import Fault, dumps, loads

import pytest

from play_launch.cli import node
from play_launch.cli.app import app
from play_launch.graph_daemon.contract import HOST, JSON_METHOD, DaemonAddress

LIMIT = 60.0


class ScriptedDaemon:
    """Serves one connection after the other; ``behave`` gets each with its request."""

    def __init__(self, behave: Callable[[socket.socket, bytes], None]) -> None:
        self._behave = behave
        self.requests: list[bytes] = []
        self._listener = socket.create_server((HOST, 0))
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    @property
    def address(self) -> DaemonAddress:
        """Where it listens; a domain's own port may be taken by a real daemon."""
        return _At(self._listener.getsockname()[1])

    def close(self) -> None:
        # Wakes the accept.
        self._listener.shutdown(socket.SHUT_RDWR)
        self._thread.join(LIMIT)
        assert not self._thread.is_alive()
        self._listener.close()

    def _serve(self) -> None:
        while True:
            try:
                connection, _ = self._listener.accept()
            except OSError:
                return
            with connection:
                connection.settimeout(LIMIT)
                request = read_request(connection)
                self.requests.append(request)
                try:
                    self._behave(connection, request)
                except OSError:
                    continue


class _At(DaemonAddress):
    """An address with a port of its own."""

    def __init__(self, port: int) -> None:
        super().__init__(0)
        object.__setattr__(self, "_port", port)

    @property
    def port(self) -> int:
        port: int = self.__dict__["_port"]
        return port


@contextmanager
def scripted(behave: Callable[[socket.socket, bytes], None]) -> Iterator[ScriptedDaemon]:
    daemon = ScriptedDaemon(behave)
    try:
        yield daemon
    finally:
        daemon.close()


def read_request(connection: socket.socket) -> bytes:
    received = b""
    while b"</methodCall>" not in received:
        chunk = connection.recv(65536)
        if not chunk:
            break
        received += chunk
    return received


def asked(request: bytes) -> tuple[str, tuple[object, ...]]:
    """Return the method and its arguments."""
    arguments, method = loads(request.partition(b"\r\n\r\n")[2])
    return str(method), arguments


def reply(value: object, *, status: str = "200 OK", length: int | None = None) -> bytes:
    """Write a value, or a Fault, as the standard library's server does."""
    content: Any = value if isinstance(value, Fault) else (value,)
    body = dumps(content, methodresponse=True, allow_none=True).encode()
    return http(body, status=status, length=length)


def http(body: bytes, *, status: str = "200 OK", length: int | None = None) -> bytes:
    size = len(body) if length is None else length
    return f"HTTP/1.0 {status}\r\nContent-Length: {size}\r\n\r\n".encode() + body


def answering(answers: dict[str, object]) -> Callable[[socket.socket, bytes], None]:
    """Answer each method with its value; with a fault if it has none, as the real ones do."""

    def behave(connection: socket.socket, request: bytes) -> None:
        method, arguments = asked(request)
        if is_json := method == JSON_METHOD:
            method, *arguments = map(str, arguments)  # type: ignore[assignment]
        missing = Fault(1, f"<class 'Exception'>:method {method!r} is not supported")
        value = answers.get(method, missing)
        value = value(*arguments) if callable(value) else value
        is_text = is_json and not isinstance(value, Fault)
        connection.sendall(reply(json.dumps(value) if is_text else value))

    return behave


NODES = [["talker", "/"], ["_hidden", "/a"], ["camera", "/sensing"]]
TOPICS = [["/z/_private", ["p/P"]], ["/rosout", ["rcl_interfaces/msg/Log"]], ["/a", ["x/A", "x/B"]]]
SERVICES = [["/s/_x", ["p/P"]], ["/s", ["p/srv/S"]]]
ANSWERS: dict[str, object] = {
    "get_node_names_and_namespaces": NODES,
    "get_topic_names_and_types": TOPICS,
    "get_service_names_and_types": SERVICES,
    "get_subscriber_names_and_types_by_node": [["/in", ["x/In"]], ["/_h", ["x/H"]]],
    "get_publisher_names_and_types_by_node": [["/out", ["x/Out"]], ["/b", ["x/B", "x/C"]]],
    "get_service_names_and_types_by_node": [["/s", ["p/srv/S"]]],
    "get_client_names_and_types_by_node": [],
    "get_action_server_names_and_types_by_node": [["/act", ["p/action/A"]]],
    "get_action_client_names_and_types_by_node": [],
}
CAMERA = """\
/sensing/camera
  Subscribers:
    /in: x/In
  Publishers:
    /b: x/B, x/C
    /out: x/Out
  Service Servers:
    /s: p/srv/S
  Service Clients:
  Action Servers:
    /act: p/action/A
  Action Clients:
"""
WARNED = "warning: several nodes have the same name, which ROS does not allow: "
Ask = Callable[..., int]


def command_line(arguments: Sequence[str]) -> int:
    """Run a command in this process and return its exit code."""
    with pytest.raises(SystemExit) as end:
        app(list(arguments), prog_name="play-launch")
    assert isinstance(end.value.code, int)
    return end.value.code


@pytest.fixture
def ask(monkeypatch: pytest.MonkeyPatch) -> Iterator[Ask]:
    """Run a verb against a daemon that answers ``answers``, or the above."""
    daemons: list[ScriptedDaemon] = []

    def run(*arguments: str, answers: dict[str, object] = ANSWERS) -> int:
        daemon = ScriptedDaemon(answering(answers))
        daemons.append(daemon)
        monkeypatch.setattr(node, "daemon_address", lambda: daemon.address)
        return command_line(arguments)

    yield run
    for daemon in daemons:
        daemon.close()


def free_address() -> DaemonAddress:
    daemon = ScriptedDaemon(answering({}))
    address = daemon.address
    daemon.close()
    return address


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ("node list", "/sensing/camera\n/talker\n"),
        ("node list -a", "/a/_hidden\n/sensing/camera\n/talker\n"),
        ("node list -c", "2\n"),
        ("node list --all --count-nodes", "3\n"),
        ("topic list", "/a\n/rosout\n"),
        ("topic list -t", "/a [x/A, x/B]\n/rosout [rcl_interfaces/msg/Log]\n"),
        ("topic list --include-hidden-topics", "/a\n/rosout\n/z/_private\n"),
        ("topic list --count-topics", "2\n"),
        ("service list", "/s\n"),
        ("service list --show-types", "/s [p/srv/S]\n"),
        ("service list --include-hidden-services -c", "2\n"),
    ],
)
def test_lists(ask: Ask, capsys: pytest.CaptureFixture[str], arguments: str, expected: str) -> None:
    assert ask(*arguments.split()) == 0
    assert capsys.readouterr() == (expected, "")


def test_lists_as_json(ask: Ask, capsys: pytest.CaptureFixture[str]) -> None:
    assert ask("node", "list", "--json") == 0
    assert json.loads(capsys.readouterr().out) == [
        {"name": "camera", "namespace": "/sensing", "full_name": "/sensing/camera"},
        {"name": "talker", "namespace": "/", "full_name": "/talker"},
    ]
    assert ask("topic", "list", "--json") == 0
    assert json.loads(capsys.readouterr().out) == [
        {"name": "/a", "types": ["x/A", "x/B"]},
        {"name": "/rosout", "types": ["rcl_interfaces/msg/Log"]},
    ]


def test_two_nodes_of_one_name_are_listed_and_warned_about(
    ask: Ask, capsys: pytest.CaptureFixture[str]
) -> None:
    twice: dict[str, object] = {"get_node_names_and_namespaces": [["n", "/"], ["n", "/"]]}
    assert ask("node", "list", answers=twice) == 0
    out, err = capsys.readouterr()
    assert out == "/n\n/n\n"
    assert err.startswith("warning: several nodes have the same name")


CURSED = "cursed\x9b2J\x7f\nforged"


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ("node list", "/cursed2J forged\n/cursed2J forged\n"),
        ("topic list -t", "/cursed2J forged [cursed2J forged]\n"),
        ("service list", "/cursed2J forged\n"),
    ],
)
def test_names_do_nothing_to_a_terminal(
    ask: Ask, capsys: pytest.CaptureFixture[str], arguments: str, expected: str
) -> None:
    named = [[f"/{CURSED}", [CURSED]]]
    answers: dict[str, object] = {
        "get_node_names_and_namespaces": [[CURSED, "/"]] * 2,
        "get_topic_names_and_types": named,
        "get_service_names_and_types": named,
    }
    assert ask(*arguments.split(), answers=answers) == 0
    out, err = capsys.readouterr()
    assert out == expected
    assert err in {"", f"{WARNED}/cursed2J forged\n"}
    assert ask(*arguments.split()[:2], "--json", answers=answers) == 0
    out, err = capsys.readouterr()
    assert out.isascii()
    assert out.strip().isprintable()
    assert CURSED in json.loads(out)[0]["name"]


def test_what_a_daemon_reports_does_nothing_to_a_terminal(
    ask: Ask, capsys: pytest.CaptureFixture[str]
) -> None:
    broken: dict[str, object] = {"get_node_names_and_namespaces": Fault(1, CURSED)}
    assert ask("node", "list", answers=broken) == 1
    assert capsys.readouterr().err.replace("\n", "").isprintable()


def test_node_info(ask: Ask, capsys: pytest.CaptureFixture[str]) -> None:
    assert ask("node", "info", "/sensing/camera") == 0
    assert capsys.readouterr() == (CAMERA, "")


def test_node_info_as_json_with_hidden_names(ask: Ask, capsys: pytest.CaptureFixture[str]) -> None:
    assert ask("node", "info", "talker", "--json", "--include-hidden") == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["full_name"] == "/talker"
    assert [entry["name"] for entry in facts["subscribers"]] == ["/_h", "/in"]
    assert facts["action_servers"] == [{"name": "/act", "types": ["p/action/A"]}]


def test_info_about_a_node_that_is_not_there(ask: Ask, capsys: pytest.CaptureFixture[str]) -> None:
    assert ask("node", "info", "/absent") == 1
    assert capsys.readouterr() == ("", "error: there is no node /absent\n")


def test_info_about_a_node_that_goes_meanwhile(
    ask: Ask, capsys: pytest.CaptureFixture[str]
) -> None:
    listings = iter([[["n", "/"]], []])
    gone: dict[str, object] = {"get_node_names_and_namespaces": lambda: next(listings)}
    assert ask("node", "info", "/n", answers=gone) == 1
    assert "error: the node /n has exited meanwhile" in capsys.readouterr().err


def test_without_a_daemon_the_fix_is_shown(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    address = free_address()
    monkeypatch.setattr(node, "daemon_address", lambda: address)
    assert command_line(["node", "list", "--no-start"]) == 1
    place = f"127.0.0.1:{address.port}"
    fix = "start one with 'play-launch daemon start'"
    text = f"error: no daemon runs for ROS domain 0 ({place}); {fix}\n"
    assert capsys.readouterr() == ("", text)


def test_a_silent_daemon_is_reported_after_the_timeout(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    release = threading.Event()

    def behave(connection: socket.socket, request: bytes) -> None:
        release.wait(LIMIT)

    with scripted(behave) as daemon:
        monkeypatch.setattr(node, "daemon_address", lambda: daemon.address)
        assert command_line(["node", "list", "--call-timeout", "0.2"]) == 1
        release.set()
    assert "did not answer within 0.2 s" in capsys.readouterr().err


# Runs the command on the port that is given, and says at its end what it has imported.
COMMAND = """
import sys
from play_launch.cli import entry, node
from play_launch.graph_daemon.contract import DaemonAddress
class At(DaemonAddress):
    port = int(sys.argv.pop(1))
node.daemon_address = lambda: At(0)
try:
    entry.main()
finally:
    heavy = {"rich", "pydantic", "rclpy", "xmlrpc", "asyncio", "http", "yaml"}
    print("imported:", *sorted((heavy | {"psutil"}) & set(sys.modules)), file=sys.stderr)
"""


def command(port: int, *arguments: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", COMMAND, str(port), *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def test_the_command_imports_nothing_heavy() -> None:
    with scripted(answering(ANSWERS)) as daemon:
        process = command(daemon.address.port, "node", "info", "/talker", "--json")
        out, err = process.communicate(timeout=LIMIT)
    assert (process.returncode, err) == (0, "imported:\n")
    assert json.loads(out)["full_name"] == "/talker"


def test_a_reader_that_has_seen_enough_is_no_error() -> None:
    answered = threading.Event()
    behave = answering({"get_topic_names_and_types": [[f"/t{n}", []] for n in range(50_000)]})

    def after_the_reader_has_gone(connection: socket.socket, request: bytes) -> None:
        answered.wait(LIMIT)
        behave(connection, request)

    with scripted(after_the_reader_has_gone) as daemon:
        process = command(daemon.address.port, "topic", "list")
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()
        answered.set()
        err = process.stderr.read()
        assert process.wait(LIMIT) == 0
        process.stderr.close()
    assert err == "imported:\n"
