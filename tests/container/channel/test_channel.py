"""The supervisor's end of the control channel, against a scripted container."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import AsyncIterator
from contextlib import closing
from typing import Any

import pytest
from msgspec import structs

from play_launch.config.model import ParameterConfig, ParameterType, ParameterValue
from play_launch.container import channel as channel_module
from play_launch.container.cdr import messages as layouts
from play_launch.container.channel import ChannelClosedError, ControlChannel, VersionMismatchError
from play_launch.container.codec import (
    ControlError,
    EncodeError,
    FrameDecoder,
    FrameKind,
    encode_frame,
    encode_message,
)
from play_launch.container.messages import (
    Accepted,
    Cancel,
    Hello,
    Incoming,
    Load,
    NodeStatus,
    NodeStatusState,
    Query,
    Rejected,
    Shutdown,
    Status,
    Unload,
)
from play_launch.supervisor.events import ComponentEvent, ComponentEventKind

pytestmark = pytest.mark.anyio
OURS = Hello(version="1.0")
THEIRS = Hello(version="1.0", pid=7, full_node_name="/container", backends=("native",))
LOAD = Load(
    attempt=1,
    package_name="demo",
    plugin_name="demo::Talker",
    node_name="talker",
    node_namespace="/a",
    log_level=20,
    remap_rules=("chatter:=/b",),
    parameters=(ParameterConfig("rate", ParameterValue(ParameterType.DOUBLE, 5.0)),),
    extra_arguments=(ParameterConfig("by_pointer", ParameterValue(ParameterType.BOOL, True)),),
    resources=("nice 5",),
    lock_memory=True,
)

NODE = NodeStatus(
    unique_id=1,
    attempt=2,
    state=NodeStatusState.LOADED,
    full_node_name="/talker",
    pid=3,
    start_time=4,
    elapsed_ns=5,
    cpu_time_ns=6,
    silence_ns=-1,
    note="waits",
)


def event(number: int) -> ComponentEvent:
    return ComponentEvent(
        stamp_ns=number,
        kind=ComponentEventKind.LOADED,
        container="/container",
        unique_id=number,
        attempt=number,
        full_node_name="/talker",
        package_name="demo",
        plugin_name="demo::Talker",
    )


SAID = {
    Hello: (FrameKind.HELLO, layouts.CONTROL_HELLO),
    Accepted: (FrameKind.ACCEPTED, layouts.CONTROL_ACCEPTED),
    Rejected: (FrameKind.REJECTED, layouts.CONTROL_REJECTED),
    Status: (FrameKind.STATUS, layouts.CONTROL_STATUS),
    ComponentEvent: (FrameKind.EVENT, layouts.COMPONENT_EVENT),
}
HEARD = {
    FrameKind.HELLO: layouts.CONTROL_HELLO,
    FrameKind.LOAD: layouts.CONTROL_LOAD,
    FrameKind.QUERY: layouts.CONTROL_QUERY,
    FrameKind.CANCEL: layouts.CONTROL_CANCEL,
    FrameKind.UNLOAD: layouts.CONTROL_UNLOAD,
    FrameKind.SHUTDOWN: layouts.CONTROL_SHUTDOWN,
}


def frame_of(message: Incoming) -> bytes:
    """What a container sends."""
    kind, layout = SAID[type(message)]
    values = {name: getattr(message, name, None) for name in layout.types}
    match message:
        case ComponentEvent():
            values |= {"stamp": message.stamp_ns, "event_type": message.kind}
        case Status():
            values["nodes"] = tuple(map(structs.asdict, message.nodes))
    return encode_frame(kind, layout.write(values))


class Container:
    """The other end; whole messages in and out, or any bytes."""

    def __init__(self, end: socket.socket, other_end: socket.socket) -> None:
        end.setblocking(False)
        self.socket = end
        self.other_end = other_end
        self._decoder = FrameDecoder()
        self._received: list[tuple[FrameKind, dict[str, Any]]] = []

    async def say(self, *messages: Incoming) -> None:
        await self.write(b"".join(frame_of(message) for message in messages))

    async def write(self, data: bytes) -> None:
        await asyncio.get_running_loop().sock_sendall(self.socket, data)

    async def hear(self) -> tuple[FrameKind, dict[str, Any]]:
        while not self._received:
            data = await asyncio.get_running_loop().sock_recv(self.socket, 65536)
            assert data, "the supervisor closed the channel"
            for frame in self._decoder.feed(data):
                kind = FrameKind(frame.kind)
                self._received.append((kind, HEARD[kind].read(frame.payload)))
        return self._received.pop(0)


@pytest.fixture
async def container() -> AsyncIterator[Container]:
    end, other_end = socket.socketpair()
    with end, other_end:
        end.setblocking(False)
        yield Container(end, other_end)


@pytest.fixture
async def channel(container: Container) -> AsyncIterator[ControlChannel]:
    with closing(ControlChannel(container.other_end, container="/container")) as opened:
        yield opened


async def receive(channel: ControlChannel) -> Incoming:
    return await channel.receive()


async def test_everything_is_understood_on_both_sides(
    channel: ControlChannel, container: Container
) -> None:
    channel.send(LOAD)
    channel.send(Query(query_id=5, unique_ids=(1, 2)))
    channel.send(Cancel(unique_id=3))
    channel.send(Unload(unique_id=4))
    channel.send(Shutdown(reason="enough"))
    kind, load = await container.hear()
    parameters = [
        {name: value for name, value in each["value"].items() if value}
        for each in (*load.pop("parameters"), *load.pop("extra_arguments"))
    ]
    assert parameters == [{"type": 3, "double_value": 5.0}, {"type": 1, "bool_value": True}]
    assert (kind, load) == (FrameKind.LOAD, {name: getattr(LOAD, name) for name in load})
    assert [await container.hear() for _ in range(4)] == [
        (FrameKind.QUERY, {"query_id": 5, "unique_ids": (1, 2)}),
        (FrameKind.CANCEL, {"unique_id": 3}),
        (FrameKind.UNLOAD, {"unique_id": 4}),
        (FrameKind.SHUTDOWN, {"reason": "enough"}),
    ]
    answers: list[Incoming] = [
        Accepted(attempt=1, unique_id=1),
        Rejected(attempt=2, unique_id=0, reason="no"),
        Status(query_id=5, nodes=(NODE,), dropped_frames=1, crashes=2, dead_locks=("a lock",)),
        event(1),
    ]
    await container.say(*answers)
    assert [await receive(channel) for _ in answers] == answers


async def test_the_end_comes_after_what_was_said(
    channel: ControlChannel, container: Container
) -> None:
    await container.say(*(event(number) for number in range(500)))
    container.socket.close()
    got = [await channel.receive() for _ in range(500)]
    assert got == [event(number) for number in range(500)]
    with pytest.raises(ChannelClosedError, match=r"closed the control channel$"):
        await channel.receive()
    with pytest.raises(ChannelClosedError):
        channel.send(Cancel(unique_id=1))


async def test_sending_to_the_dead_loses_nothing_that_they_said(
    channel: ControlChannel, container: Container
) -> None:
    await container.say(event(1), event(2))
    container.socket.close()
    channel.send(Query(query_id=1))
    with pytest.raises(ChannelClosedError, match="gone"):
        channel.send(Query(query_id=2))
    assert [await channel.receive() for _ in range(2)] == [event(1), event(2)]


async def test_an_end_inside_a_frame_is_an_end(
    channel: ControlChannel, container: Container
) -> None:
    await container.write(frame_of(event(1))[:-3])
    container.socket.close()
    with pytest.raises(ChannelClosedError, match="inside a frame"):
        await receive(channel)


@pytest.mark.parametrize(
    ("data", "text"),
    [
        (b"\xff\xff\xff\xff", "frame of 4294967295 bytes"),
        (b"\x03\0\0\0", "frame of 3 bytes"),
        (encode_frame(5, b"rubbish"), "payload of a EVENT frame cannot be read"),
        (encode_frame(2, b""), "payload of a LOAD frame cannot be read"),
    ],
)
async def test_rubbish_ends_the_channel_after_what_was_said(
    channel: ControlChannel, container: Container, data: bytes, text: str
) -> None:
    await container.say(event(1))
    await container.write(data)
    assert await receive(channel) == event(1)
    for _ in range(2):
        with pytest.raises(ControlError, match=text):
            await receive(channel)
    assert await asyncio.get_running_loop().sock_recv(container.socket, 1) == b""


async def test_a_message_for_containers_is_refused(
    channel: ControlChannel, container: Container
) -> None:
    await container.write(encode_message(LOAD))
    with pytest.raises(ControlError, match="only a supervisor may"):
        await receive(channel)


async def test_an_unknown_kind_is_skipped_and_reported(
    channel: ControlChannel, container: Container, caplog: pytest.LogCaptureFixture
) -> None:
    await container.write(encode_frame(99, b"news"))
    await container.say(event(1))
    assert await receive(channel) == event(1)
    assert "/container sent a frame of unknown kind 99" in caplog.text


async def test_another_version_in_a_frame_is_told(
    channel: ControlChannel, container: Container
) -> None:
    await container.write(encode_frame(1, b"unknown", version=2))
    with pytest.raises(VersionMismatchError, match="version 2") as caught:
        await channel.handshake(OURS)
    assert caught.value.version == 2


async def test_another_version_in_the_hello_is_told(
    channel: ControlChannel, container: Container
) -> None:
    await container.say(Hello(version="9", protocol_version=9))
    with pytest.raises(VersionMismatchError):
        await channel.handshake(OURS)
    assert await asyncio.get_running_loop().sock_recv(container.socket, 1) == b""


async def test_a_container_without_a_hello_is_refused(
    channel: ControlChannel, container: Container
) -> None:
    await container.say(event(1), THEIRS)
    with pytest.raises(ControlError, match="ComponentEvent came instead of a hello"):
        await channel.handshake(OURS)


async def test_a_slow_reader_slows_the_container_down(
    channel: ControlChannel, container: Container, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(channel_module, "MAX_QUEUED_FRAMES", 100)
    count = 2000
    said = 0

    async def talk() -> None:
        nonlocal said
        for number in range(count):
            await container.say(event(number))
            said += 1

    talking = asyncio.create_task(talk())
    # Until nothing moves any more: the queue is full, and so is the socket.
    before = -1
    while said != before or said < channel_module.MAX_QUEUED_FRAMES:
        before = said
        await asyncio.sleep(0.02)
    assert not talking.done()
    assert said < channel_module.MAX_QUEUED_FRAMES + count / 2
    for number in range(count):
        assert await receive(channel) == event(number)
    await talking


async def test_a_container_that_does_not_read_is_broken(
    channel: ControlChannel, container: Container, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(channel_module, "MAX_OUTGOING_BYTES", 100_000)

    def send_many() -> None:
        for _ in range(100_000):
            channel.send(LOAD)

    for _ in range(2):
        with pytest.raises(ControlError, match="does not read"):
            send_many()
    with pytest.raises(ControlError):
        await receive(channel)


async def test_what_the_socket_does_not_take_at_once_is_sent_later(
    channel: ControlChannel, container: Container
) -> None:
    room = container.other_end.getsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF)
    count = room // len(encode_message(Cancel(unique_id=0))) + 1
    for number in range(count):
        channel.send(Cancel(unique_id=number))
    for number in range(count):
        assert await container.hear() == (FrameKind.CANCEL, {"unique_id": number})


async def test_a_message_that_cannot_be_sent_affects_no_other(
    channel: ControlChannel, container: Container
) -> None:
    with pytest.raises(EncodeError):
        channel.send(Cancel(unique_id=-1))
    channel.send(Cancel(unique_id=1))
    assert await container.hear() == (FrameKind.CANCEL, {"unique_id": 1})


async def test_closing_wakes_the_reader(channel: ControlChannel, container: Container) -> None:
    reading = asyncio.create_task(channel.receive())
    await asyncio.sleep(0)
    channel.close()
    channel.close()
    with pytest.raises(ChannelClosedError, match="by the supervisor"):
        await reading
    with pytest.raises(ControlError):
        channel.send(Shutdown(reason=""))
    assert await asyncio.get_running_loop().sock_recv(container.socket, 1) == b""
    assert "by the supervisor" in repr(channel)
