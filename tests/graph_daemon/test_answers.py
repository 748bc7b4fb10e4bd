"""The daemon's answers, beside those recorded from ros2cli's daemon (0.32.2, rclpy 7.1)."""

from __future__ import annotations

import hashlib
import http.client
import json
from pathlib import Path
from typing import Any

import pytest

from play_launch.graph_daemon.contract import GRAPH_METHODS, STATUS_METHOD, DaemonAddress
from tests.graph_daemon.scene import NODES, SERVICE, TOPICS
from tests.graph_daemon.wire import ask, comparable, post, read, request_body

Call = tuple[str, list[Any]]

BY_NODE = [method for method in GRAPH_METHODS if method.endswith("_by_node")]
BY_TOPIC = ["get_publishers_info_by_topic", "get_subscriptions_info_by_topic"]
COUNTS = ["count_publishers", "count_subscribers", "count_clients", "count_services"]
ALL_AT_ONCE = [
    method for method in GRAPH_METHODS if method not in {*BY_NODE, *BY_TOPIC, *COUNTS, "get_name"}
]


def calls() -> list[Call]:
    return [*introspection(), *about_the_graph(), *mistakes()]


def introspection() -> list[Call]:
    system = ["listMethods", "methodHelp", "methodSignature", "shutdown"]
    names = [*GRAPH_METHODS, *(f"system.{name}" for name in system), "unknown", ""]
    return [
        ("system.listMethods", []),
        *(("system.methodHelp", [name]) for name in names),
        ("system.methodSignature", ["get_name"]),
        ("system.methodSignature", ["unknown"]),
    ]


def about_the_graph() -> list[Call]:
    found: list[Call] = [(method, []) for method in ALL_AT_ONCE]
    found += [("get_topic_names_and_types", [no_demangle]) for no_demangle in (False, True)]
    found += [(method, list(node)) for method in BY_NODE for node in NODES]
    found += [("get_publisher_names_and_types_by_node", ["talker", "/", True])]
    found += [("get_subscriber_names_and_types_by_node", ["listener", "/", True])]
    found += [(method, [topic]) for method in BY_TOPIC for topic in (*TOPICS, "/nobody", "chatter")]
    found += [(method, ["rt/chatter", True]) for method in BY_TOPIC]
    found += [(method, ["/rosout", False]) for method in BY_TOPIC]
    found += [(method, [name]) for method in COUNTS for name in (*TOPICS, SERVICE, "chatter")]
    return found


def mistakes() -> list[Call]:
    found: list[Call] = [
        ("unknown", []),
        ("", []),
        ("_dispatch", []),
        ("system.multicall", [[]]),
        ("get_node_names_and_namespaces.__class__", []),
        ("system.listMethods", [1]),
        ("system.methodHelp", []),
        ("get_topic_names_and_types", ["yes"]),
        ("get_topic_names_and_types", [True, True]),
        ("get_publishers_info_by_topic", ["/chatter", "no"]),
        ("get_publishers_info_by_topic", []),
        ("get_name", [{"a": [1, 2.5, None, True]}]),
    ]
    found += [(method, [1]) for method in ALL_AT_ONCE if method != "get_topic_names_and_types"]
    found += [(method, []) for method in BY_NODE]
    found += [(method, ["nobody", "/"]) for method in BY_NODE]
    found += [(method, ["talker", "nowhere"]) for method in BY_NODE]
    found += [(method, ["bad name", "/"]) for method in BY_NODE]
    found += [
        (method, [name])
        for method in (*BY_TOPIC, *COUNTS)
        for name in ("bad name", "", "a//b", "ünï", "<&>", 5, None)
    ]
    return found


RECORDED = Path(__file__).parent / "recorded" / "ros2cli_0_32_2.jsonl"


def recorded() -> list[dict[str, Any]]:
    return [json.loads(line) for line in RECORDED.read_text(encoding="utf-8").splitlines()]


def test_the_recording_holds_every_call() -> None:
    assert [(entry["method"], entry["arguments"]) for entry in recorded()] == calls()
    assert len(calls()) >= 72
    assert {method for method, _ in calls()} >= set(GRAPH_METHODS)


@pytest.mark.parametrize(
    ("call", "entry"),
    list(zip(calls(), recorded(), strict=True)),
    ids=[f"{method}{arguments!r}"[:60] for method, arguments in calls()],
)
def test_the_answer_is_the_recorded_one(
    known_scene: DaemonAddress, call: Call, entry: dict[str, Any]
) -> None:
    method, arguments = call
    status, body = post(known_scene, request_body(method, arguments))
    assert status == 200
    answer = comparable(method, read(body))
    if "sha256" in entry:
        # A text of rclpy or Python, which is not repeated in the recording.
        assert hashlib.sha256(answer.encode()).hexdigest() == entry["sha256"]
    else:
        assert answer == entry["answer"]


def test_our_own_method_is_not_listed(daemon: DaemonAddress) -> None:
    status = json.loads(ask(daemon, STATUS_METHOD))
    assert status["daemon"] == "play_launch"
    assert STATUS_METHOD not in ask(daemon, "system.listMethods")


def test_a_client_with_the_generation_gets_no_status_until_it_changes(
    known_scene: DaemonAddress,
) -> None:
    from tests.support.ros import Probe
    from tests.support.waiting import until

    known = ""

    def is_at_rest() -> bool:
        nonlocal known
        known = str(json.loads(ask(known_scene, STATUS_METHOD))["generation"])
        return bool(ask(known_scene, STATUS_METHOD, known) == "")

    until(is_at_rest, "a graph at rest")
    with Probe("newcomer"):
        until(lambda: ask(known_scene, STATUS_METHOD, known) != "", "a change")
    assert int(json.loads(ask(known_scene, STATUS_METHOD, known))["generation"]) > int(known)


def test_a_changed_graph_is_answered_at_once(known_scene: DaemonAddress) -> None:
    """The node of `Probe` is unknown, known and unknown again, through a warm cache."""
    from tests.support.ros import Probe
    from tests.support.waiting import until

    def is_known() -> bool:
        return ["newcomer", "/"] in ask(known_scene, "get_node_names_and_namespaces")

    assert not is_known()
    with Probe("newcomer"):
        until(is_known, "the new node")
    until(lambda: not is_known(), "the end of the node")


@pytest.mark.parametrize(
    ("path", "body", "status"),
    [
        ("/", b"", 404),
        ("/RPC2", b"", 404),
        ("/ros2cli", b"", 404),
        ("/ros2cli/", b"", 200),
        ("/ros2cli/", b"\0\xff", 200),
        ("/ros2cli/", b"<methodCall/>", 200),
    ],
)
def test_what_is_no_call_is_a_fault(
    daemon: DaemonAddress, path: str, body: bytes, status: int
) -> None:
    answered, answer = post(daemon, body, path=path)
    assert answered == status
    if status == 200:
        assert read(answer)[0] == "fault"


@pytest.mark.parametrize(
    "header", [("Origin", "http://example.org"), ("Host", "example.org:11511")]
)
def test_a_page_of_the_web_cannot_shut_it_down(
    daemon: DaemonAddress, header: tuple[str, str]
) -> None:
    connection = http.client.HTTPConnection(daemon.host, daemon.port, timeout=60)
    body = request_body("system.shutdown", [])
    connection.request("POST", daemon.path, body, dict([header]))
    assert connection.getresponse().status == 403
    connection.close()
    assert post(daemon, request_body("get_namespace", []))[0] == 200
