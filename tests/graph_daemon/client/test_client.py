"""The thin client against daemons that answer well, badly, late or not at all."""

from __future__ import annotations

import socket
import struct
import threading
from xmlrpc.client import Fault

import pytest

from play_launch.graph_daemon.client import graph_client as client_module
from play_launch.graph_daemon.client.graph_client import (
    BadReplyError,
    DaemonError,
    DaemonTimeoutError,
    GraphClient,
    Named,
    NoDaemonError,
    NodeName,
    RemoteError,
)
from tests.graph_daemon.client.scripted_daemon import (
    LIMIT,
    ScriptedDaemon,
    answering,
    asked,
    http,
    reply,
    scripted,
)

NODES = "get_node_names_and_namespaces"
TOPICS = "get_topic_names_and_types"


def client_of(daemon: ScriptedDaemon, timeout: float = LIMIT) -> GraphClient:
    return GraphClient(daemon.address, timeout)


def test_nodes_are_sorted_by_full_name() -> None:
    found = [["talker", "/"], ["b", "/a"], ["a", "/b/c"]]
    with scripted(answering({NODES: found})) as daemon:
        nodes = client_of(daemon).nodes()
    assert nodes == [NodeName("b", "/a"), NodeName("a", "/b/c"), NodeName("talker", "/")]
    assert [node.full_name for node in nodes] == ["/a/b", "/b/c/a", "/talker"]


def test_names_and_types_are_sorted_and_complete() -> None:
    found = [["/z", ["t/A", "t/B"]], ["/a", []]]
    with scripted(answering({TOPICS: found})) as daemon:
        assert client_of(daemon).names_and_types(TOPICS) == [
            Named("/a", ()),
            Named("/z", ("t/A", "t/B")),
        ]


def test_arguments_arrive_as_they_were_given() -> None:
    method = "get_publisher_names_and_types_by_node"
    with scripted(answering({method: []})) as daemon:
        client_of(daemon).names_and_types(method, "a<b>&c", "/ñ/<")
        assert asked(daemon.requests[0]) == (method, ("a<b>&c", "/ñ/<"))


def test_an_answer_without_a_length_ends_with_the_connection() -> None:
    def behave(connection: socket.socket, request: bytes) -> None:
        whole = reply([["n", "/"]])
        connection.sendall(b"HTTP/1.0 200 OK\r\n\r\n" + whole.partition(b"\r\n\r\n")[2])

    with scripted(behave) as daemon:
        assert client_of(daemon).nodes() == [NodeName("n", "/")]


def test_the_client_closes_first() -> None:
    closed = threading.Event()

    def behave(connection: socket.socket, request: bytes) -> None:
        connection.sendall(reply([]))
        if not connection.recv(1):
            closed.set()

    with scripted(behave) as daemon:
        assert client_of(daemon).nodes() == []
        assert closed.wait(LIMIT)


def test_an_answer_may_come_in_pieces_and_be_large() -> None:
    topics = [[f"/topic_{index:06}", ["std_msgs/msg/String"]] for index in range(20_000)]

    def behave(connection: socket.socket, request: bytes) -> None:
        whole = reply(topics)
        connection.sendall(whole[:10])
        connection.sendall(whole[10:70])
        connection.sendall(whole[70:])

    with scripted(behave) as daemon:
        found = client_of(daemon).names_and_types(TOPICS)
    assert len(found) == 20_000
    assert found[-1] == Named("/topic_019999", ("std_msgs/msg/String",))


def test_nobody_there_is_reported_with_the_domain() -> None:
    daemon = ScriptedDaemon(answering({}))
    address = daemon.address
    daemon.close()
    with pytest.raises(NoDaemonError, match="no daemon runs for ROS domain 0"):
        GraphClient(address, LIMIT).nodes()


def test_a_reset_connection_is_tried_again() -> None:
    resets = 3

    def behave(connection: socket.socket, request: bytes) -> None:
        nonlocal resets
        if resets:
            resets -= 1
            # Closing without lingering resets.
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            return
        connection.sendall(reply([["n", "/"]]))

    with scripted(behave) as daemon:
        assert client_of(daemon).nodes() == [NodeName("n", "/")]
        assert len(daemon.requests) == 4


def test_a_daemon_that_always_closes_ends_in_a_timeout() -> None:
    with scripted(lambda _connection, _request: None) as daemon:
        with pytest.raises(DaemonTimeoutError, match=r"has not answered within 0\.2 s"):
            client_of(daemon, 0.2).nodes()
        assert len(daemon.requests) > 1


@pytest.mark.parametrize("start", [b"", b"HTTP/1.0 200 OK\r\nContent-Length: 100\r\n\r\n<?xml"])
def test_silence_ends_in_a_timeout(start: bytes) -> None:
    release = threading.Event()

    def behave(connection: socket.socket, request: bytes) -> None:
        connection.sendall(start)
        release.wait(LIMIT)

    with scripted(behave) as daemon:
        with pytest.raises(DaemonTimeoutError):
            client_of(daemon, 0.2).nodes()
        release.set()


def test_a_trickle_does_not_outlive_the_deadline() -> None:
    # Each byte comes in time; the whole does not.
    def behave(connection: socket.socket, request: bytes) -> None:
        connection.sendall(b"HTTP/1.0 200 OK\r\n\r\n")
        while True:
            connection.sendall(b" ")
            paced.wait(0.01)

    paced = threading.Event()
    with scripted(behave) as daemon, pytest.raises(DaemonTimeoutError):
        client_of(daemon, 0.3).nodes()


@pytest.mark.parametrize(
    ("answer", "reason"),
    [
        (b"SSH-2.0-OpenSSH_9.6\r\n", "does not speak HTTP"),
        (reply([], status="404 Not Found"), "HTTP status 404"),
        (reply([], status="500 Internal Server Error"), "HTTP status 500"),
        (http(b"<html>hello"), "unknown type 'html'"),
        (http(b"hello"), "no XML"),
        (http(b""), "no XML"),
        (http(b"<methodResponse/>"), "no method response"),
        (http(b"<!DOCTYPE a [<!ENTITY b 'c'>]><methodResponse/>"), "document type"),
        (http(b"<a>", length=-5), "Content-Length"),
        (reply([], length=4000), "ends after"),
        (reply(5), "unknown form"),
        (reply(["n"]), "unknown form"),
        (reply([["n"]]), "unknown form"),
        (reply([[1, 2]]), "unknown form"),
    ],
)
def test_what_is_no_answer_of_a_daemon_is_reported(answer: bytes, reason: str) -> None:
    with scripted(lambda connection, _request: connection.sendall(answer)) as daemon:
        with pytest.raises(BadReplyError, match=reason) as error:
            client_of(daemon).nodes()
        assert f"127.0.0.1:{daemon.address.port}" in str(error.value)


@pytest.mark.parametrize("row", [["/t"], ["/t", "x/y"], [1, ["x/y"]], "/t"])
def test_odd_rows_of_names_and_types_are_reported(row: object) -> None:
    with scripted(answering({TOPICS: [row]})) as daemon, pytest.raises(BadReplyError):
        client_of(daemon).names_and_types(TOPICS)


def test_an_answer_without_end_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(client_module, "LARGEST_REPLY", 100_000)

    def behave(connection: socket.socket, request: bytes) -> None:
        connection.sendall(b"HTTP/1.0 200 OK\r\n\r\n")
        while True:
            connection.sendall(b" " * 65536)

    with scripted(behave) as daemon, pytest.raises(BadReplyError, match="larger than"):
        client_of(daemon).nodes()


def test_a_fault_keeps_its_text() -> None:
    fault = Fault(1, "<class 'rclpy.NodeNameNonExistentError'>:no such node")
    with scripted(answering({TOPICS: fault})) as daemon:
        with pytest.raises(RemoteError) as error:
            client_of(daemon).names_and_types(TOPICS)
        assert error.value.text == fault.faultString
        assert TOPICS in str(error.value)


def test_every_error_is_a_daemon_error() -> None:
    for kind in (BadReplyError, DaemonTimeoutError, NoDaemonError, RemoteError):
        assert issubclass(kind, DaemonError)
