"""``play-launch node | topic | service``: output, and the exit codes."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from xmlrpc.client import Fault

import pytest

from play_launch.cli import graph
from play_launch.cli.app import app
from play_launch.graph_daemon import start_stop
from play_launch.graph_daemon.contract import DaemonAddress
from tests.graph_daemon.scripted_daemon import LIMIT, ScriptedDaemon, answering, scripted

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
        monkeypatch.setattr(graph, "daemon_address", lambda: daemon.address)
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
    assert ask("node", "info", "/nobody") == 1
    assert capsys.readouterr() == ("", "error: there is no node /nobody\n")


def test_info_about_a_node_that_goes_meanwhile(
    ask: Ask, capsys: pytest.CaptureFixture[str]
) -> None:
    listings = iter([[["n", "/"]], []])
    gone: dict[str, object] = {"get_node_names_and_namespaces": lambda: next(listings)}
    assert ask("node", "info", "/n", answers=gone) == 1
    assert "error: the node /n has exited meanwhile" in capsys.readouterr().err


def test_a_fault_about_a_node_that_is_there_is_reported(
    ask: Ask, capsys: pytest.CaptureFixture[str]
) -> None:
    fault = Fault(1, "<class 'RuntimeError'>:!rclpy.ok()")
    broken = ANSWERS | {"get_client_names_and_types_by_node": fault}
    assert ask("node", "info", "/talker", answers=broken) == 1
    out, err = capsys.readouterr()
    assert out == ""
    assert "!rclpy.ok()" in err


def test_without_a_daemon_the_fix_is_shown(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    address = free_address()
    monkeypatch.setattr(graph, "daemon_address", lambda: address)
    assert command_line(["node", "list", "--no-start"]) == 1
    place = f"127.0.0.1:{address.port}"
    fix = "start one with 'play-launch daemon start'"
    text = f"error: no daemon runs for ROS domain 0 ({place}); {fix}\n"
    assert capsys.readouterr() == ("", text)


def test_without_a_daemon_ours_is_started(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with scripted(answering(ANSWERS)) as daemon:
        addresses = [free_address()]
        monkeypatch.setattr(graph, "daemon_address", lambda: addresses[-1])
        started = []

        def start(address: DaemonAddress, **_options: object) -> start_stop.StartedDaemon:
            # From now on somebody listens there.
            assert address is addresses[0]
            started.append(address)
            address.__dict__["_port"] = daemon.address.port
            return start_stop.StartedDaemon(started=True, pid=1, messages=("took over",))

        monkeypatch.setattr(start_stop, "start_daemon", start)
        assert command_line(["node", "list"]) == 0
        assert len(started) == 1
    out, err = capsys.readouterr()
    assert out
    assert err == "starting the graph daemon of ROS domain 0\nwarning: took over\n"


def test_a_daemon_that_cannot_be_started_is_reported(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def start(_address: DaemonAddress, **_options: object) -> start_stop.StartedDaemon:
        raise start_stop.DaemonStartError("no rclpy here")

    address = free_address()
    monkeypatch.setattr(graph, "daemon_address", lambda: address)
    monkeypatch.setattr(start_stop, "start_daemon", start)
    assert command_line(["topic", "list"]) == 1
    assert capsys.readouterr().err.endswith("error: no rclpy here\n")


def test_a_silent_daemon_is_reported_after_the_timeout(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    release = threading.Event()

    def behave(connection: socket.socket, request: bytes) -> None:
        release.wait(LIMIT)

    with scripted(behave) as daemon:
        monkeypatch.setattr(graph, "daemon_address", lambda: daemon.address)
        assert command_line(["node", "list", "--call-timeout", "0.2"]) == 1
        release.set()
    assert "did not answer within 0.2 s" in capsys.readouterr().err


def test_a_domain_that_is_none_is_wrong_usage(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "300")
    assert command_line(["node", "list"]) == 2
    assert "ROS_DOMAIN_ID" in capsys.readouterr().err


@pytest.mark.parametrize(
    "arguments",
    [
        "node",
        "node find",
        "node info",
        "node list --call-timeout soon",
        "topic list --nonsense",
    ],
)
def test_wrong_usage(arguments: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert command_line(arguments.split()) == 2
    assert capsys.readouterr().err.startswith(("error: ", "Usage: play-launch node"))


# Runs the command on the port that is given, and says at its end what it has imported.
COMMAND = """
import sys
from play_launch.cli import entry, graph
from play_launch.graph_daemon.contract import DaemonAddress
class At(DaemonAddress):
    port = int(sys.argv.pop(1))
graph.daemon_address = lambda: At(0)
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
