"""The control channel: what the container answers, in which order, and which peers it accepts."""

from __future__ import annotations

import os
import struct
from pathlib import Path

import pytest
from play_launch_msgs.msg import (
    ComponentEvent,
    ControlAccepted,
    ControlCancel,
    ControlHello,
    ControlLoad,
    ControlQuery,
    ControlRejected,
    ControlUnload,
    NodeStatus,
)
from rcl_interfaces.srv import GetParameters
from rclpy.serialization import serialize_message

from tests.support.control_peer import OUTGOING, Container, StartContainer, frame
from tests.support.isolated import start_time
from tests.support.ros import LATCHED, Probe

LOADED, UNLOADED = ComponentEvent.LOADED, ComponentEvent.UNLOADED
LOAD_FAILED, LOADING = ComponentEvent.LOAD_FAILED, ComponentEvent.LOADING
FOREVER = {"seconds": 3600.0}
LOAD = 2


def test_the_hello_describes_the_container(spawn: StartContainer, other_domain: int) -> None:
    container = spawn(
        "--use_multi_threaded_executor",
        "--thread_num",
        "3",
        greet=False,
        environment={"ROS_DOMAIN_ID": str(other_domain)},
    )
    hello = container.receive()
    assert isinstance(hello, ControlHello)
    assert hello.protocol_version == 1
    assert hello.pid == container.process.pid
    assert hello.start_time == start_time(hello.pid)
    assert (hello.full_node_name, hello.mode, hello.thread_num) == ("/container", "mt", 3)
    assert hello.backends in (["native"], ["native", "rclcpp"])
    assert hello.rmw_implementation.startswith("rmw_")
    assert hello.domain_id == other_domain


def test_a_load_is_accepted_then_told_in_order(container: Container) -> None:
    attempt = container.load("Talker", node_name="one", node_namespace="/ns")
    accepted = container.receive()
    assert isinstance(accepted, ControlAccepted)
    loading, loaded = container.receive(), container.receive()
    assert [m.event_type for m in (loading, loaded)] == [LOADING, LOADED]
    for event in (loading, loaded):
        assert (event.attempt, event.unique_id) == (attempt, accepted.unique_id)
        assert event.full_node_name == "/ns/one"
        assert event.pid == container.process.pid
        assert event.start_time == start_time(event.pid)
    container.send(ControlUnload(unique_id=accepted.unique_id))
    unloaded = container.receive()
    assert (unloaded.event_type, unloaded.error_message) == (UNLOADED, "")
    assert container.status().nodes == []


def test_a_repeated_attempt_starts_nothing(container: Container) -> None:
    event = container.loaded("Talker", node_name="once")
    container.load("Talker", node_name="once", attempt=event.attempt)
    again = container.receive()
    assert isinstance(again, ControlAccepted)
    assert (again.attempt, again.unique_id) == (event.attempt, event.unique_id)
    assert [node.unique_id for node in container.status().nodes] == [event.unique_id]
    assert not any(isinstance(m, ControlRejected) for m in container.seen)


def test_the_status_tells_constructing_from_loaded(container: Container) -> None:
    talker = container.loaded("Talker")
    slow = container.load("SlowConstructor", parameters=FOREVER, node_name="slow")
    loading = container.event(LOADING, attempt=slow)
    first, second = container.status().nodes
    assert (first.unique_id, first.state) == (talker.unique_id, NodeStatus.LOADED)
    assert (first.full_node_name, first.cpu_time_ns) == ("/talker", 0)
    assert (second.unique_id, second.state) == (loading.unique_id, NodeStatus.CONSTRUCTING)
    assert (second.full_node_name, second.attempt) == ("/slow", slow)
    while not container.status(loading.unique_id).nodes[0].cpu_time_ns:
        pass
    later = container.status(loading.unique_id).nodes[0]
    assert 0 < later.cpu_time_ns < later.elapsed_ns
    assert later.elapsed_ns > second.elapsed_ns
    assert container.status(4711).nodes == []


def test_a_cancelled_node_goes_when_its_constructor_returns(container: Container) -> None:
    attempt = container.load("SlowConstructor", parameters={"seconds": 0.3}, node_name="slow")
    loading = container.event(LOADING, attempt=attempt)
    container.send(ControlCancel(unique_id=loading.unique_id))
    gone = container.event(UNLOADED, attempt=attempt)
    assert gone.error_message == "cancelled"
    assert not any(getattr(m, "event_type", None) == LOADED for m in container.seen)
    container.loaded("Talker", node_name="slow")


def test_a_name_that_is_asked_for_is_given_once(container: Container) -> None:
    slow = container.load("SlowConstructor", parameters={"seconds": 0.5}, node_name="same")
    second = container.load("Talker", node_name="same")
    failed = container.event(LOAD_FAILED, attempt=second)
    assert failed.error_message.startswith("a node named /same is still constructing")
    container.event(LOADED, attempt=slow)


def test_names_that_are_not_asked_for_may_be_the_same(container: Container) -> None:
    first = container.loaded("Talker")
    second = container.loaded("Talker")
    assert second.full_node_name == first.full_node_name == "/talker"
    asked = container.load("Talker", node_name="talker")
    failed = container.event(LOAD_FAILED, attempt=asked)
    assert failed.error_message.startswith("a node named /talker is loaded")
    container.send(ControlUnload(unique_id=first.unique_id))
    container.event(UNLOADED, unique_id=first.unique_id)
    assert [node.unique_id for node in container.status().nodes] == [second.unique_id]


@pytest.mark.parametrize("request_type", [ControlCancel, ControlUnload])
def test_what_is_not_there_is_rejected(container: Container, request_type: type) -> None:
    container.send(request_type(unique_id=99))
    rejected = container.receive()
    assert isinstance(rejected, ControlRejected)
    assert (rejected.attempt, rejected.unique_id) == (0, 99)
    assert rejected.reason == "No node found with unique_id: 99"


def test_an_attempt_needs_a_number(container: Container) -> None:
    container.load("Talker", attempt=0)
    assert "attempt" in container.receive().reason


def test_frames_may_come_in_pieces(container: Container) -> None:
    payload = serialize_message(
        ControlLoad(
            attempt=7, package_name="play_launch_demo", plugin_name="play_launch_demo::Talker"
        )
    )
    data = struct.pack("<IHH", 4 + len(payload), LOAD, 1) + payload
    for byte in data:
        container.send_bytes(bytes([byte]))
    container.event(LOADED, attempt=7)


def test_an_unknown_kind_is_skipped(container: Container) -> None:
    container.send_bytes(struct.pack("<IHH", 6, 4711, 1) + b"??")
    container.loaded("Talker")
    assert "4711" in container.log.read_text()


@pytest.mark.parametrize(
    "data",
    [
        struct.pack("<I", 3) + b"abc",
        struct.pack("<I", 16 * 1024 * 1024 + 1),
        struct.pack("<IHH", 8, LOAD, 1) + b"\xff\xff\xff\xff",
        struct.pack("<IHH", 4, LOAD, 1),
    ],
    ids=["too short", "too long", "no message", "no payload"],
)
def test_a_broken_peer_ends_the_container(spawn: StartContainer, data: bytes) -> None:
    container = spawn()
    container.send_bytes(data)
    assert container.wait() == 70
    assert "protocol" in container.log.read_text()


@pytest.mark.parametrize("in_the_frame", [True, False])
def test_another_version_is_obeyed_in_stopping_only(
    spawn: StartContainer, in_the_frame: bool
) -> None:
    container = spawn(greet=False)
    container.receive()
    hello = serialize_message(ControlHello(protocol_version=1 if in_the_frame else 2))
    container.send_bytes(struct.pack("<IHH", 4 + len(hello), 1, 2 if in_the_frame else 1) + hello)
    container.load("Talker")
    assert container.shut_down() == 0
    with pytest.raises(EOFError):
        container.receive()
    assert "version 2" in container.log.read_text()


@pytest.mark.parametrize("value", ["", "x", "9999", "0"])
def test_a_wrong_descriptor_is_named(spawn: StartContainer, value: str) -> None:
    container = spawn(control=False, environment={"PLAY_LAUNCH_CONTROL_FD": value})
    assert container.wait() == 1
    assert "PLAY_LAUNCH_CONTROL_FD" in container.log.read_text()


def test_the_descriptor_is_kept_from_programs_that_nodes_start(container: Container) -> None:
    proc = Path(f"/proc/{container.process.pid}")
    (number,) = (
        link.name
        for link in (proc / "fd").iterdir()
        if str(link.readlink()) == container.control_socket
    )
    info = (proc / "fdinfo" / number).read_text()
    assert int(info.split("flags:")[1].split()[0], 8) & os.O_CLOEXEC


def test_lost_frames_can_be_asked_for(spawn: StartContainer) -> None:
    container = spawn(failpoints="container.drop_event=loaded")
    attempt = container.load("Talker")
    loading = container.event(LOADING, attempt=attempt)
    while container.status(loading.unique_id).nodes[0].state != NodeStatus.LOADED:
        pass
    assert not any(getattr(m, "event_type", None) == LOADED for m in container.seen)
    container.loaded("Listener")


def test_a_peer_that_does_not_read_blocks_no_other(spawn: StartContainer) -> None:
    container = spawn()
    # Each query is answered with all nodes: much more than the socket and the queue can hold.
    for number in range(20):
        container.loaded("Talker", node_name=f"talker_{number}")
    assert container.peer is not None
    query = frame(OUTGOING[ControlQuery], serialize_message(ControlQuery()))
    container.send_bytes(query * 20_000)
    talker = container.load("Talker", node_name="one_more")
    # Whatever was answered by now may have been dropped. Once some of the queue is read there is
    # room for new answers.
    for _ in range(1000):
        container.receive()
    status = container.status()
    assert status.dropped_frames > 0
    assert talker in {node.attempt for node in status.nodes}
    assert container.shut_down() == 0


EVENTS = "/container/_container/component_events"


def test_events_before_the_topic_was_offered_are_published(container: Container) -> None:
    loaded = container.loaded("Talker", node_name="early")
    with Probe() as probe:
        events = probe.collect(ComponentEvent, EVENTS, count=2, qos=LATCHED)
        assert [(e.event_type, e.unique_id) for e in events] == [
            (LOADING, loaded.unique_id),
            (LOADED, loaded.unique_id),
        ]
        assert probe.nodes() == [("/early", loaded.unique_id)]
        request = GetParameters.Request(names=["thread_num"])
        answer = probe.call(GetParameters, "/container/get_parameters", request)
        assert answer.values[0].integer_value == 0


def test_a_container_without_loads_offers_its_services(container: Container) -> None:
    assert container.status().nodes == []
    with Probe() as probe:
        assert probe.nodes() == []


def test_it_ends_in_order_before_it_has_offered_anything(spawn: StartContainer) -> None:
    container = spawn("--isolated")
    container.process.terminate()
    assert container.process.wait(20) == 0, container.log.read_text()
