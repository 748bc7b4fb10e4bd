"""The daemon's answers, beside those recorded from ros2cli's daemon (0.32.2, rclpy 7.1)."""

from __future__ import annotations

import hashlib
import http.client
import json
from pathlib import Path
from typing import Any

import pytest

from play_launch.graph_daemon.contract import GRAPH_METHODS, STATUS_METHOD, DaemonAddress
from tests.graph_daemon.calls import Call, calls
from tests.graph_daemon.wire import ask, comparable, post, read, request_body

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


def test_whoever_knows_the_generation_gets_no_status_until_it_changes(
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
