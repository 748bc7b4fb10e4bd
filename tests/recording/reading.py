"""Reads bags back: with rosbags, which shares no code with the writer, and record by record."""

from __future__ import annotations

import contextlib
import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from mcap.exceptions import EndOfFile
from mcap.records import Attachment, Channel, McapRecord, Message
from mcap.stream_reader import StreamReader
from rosbags.highlevel import AnyReader
from zstandard import ZstdError

from play_launch.config.node_key import NodeKey
from play_launch.supervisor.events import (
    ContainerState,
    ContainerStateChanged,
    NodeState,
    NodeStateChanged,
    ProcessEvent,
    ProcessEventKind,
)
from play_launch.supervisor.outcome import Cause, Sequel

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path


@dataclass(frozen=True)
class Read:
    """One message as rosbags reads it."""

    topic: str
    type_name: str
    log_time: int
    message: Any


def messages(path: Path) -> list[Read]:
    """All messages of a bag, decoded with the schemas that it carries itself.

    A reader goes by the file's name, so one that ends in ``.active`` has to be renamed before.
    """
    with AnyReader([path]) as reader:
        return [
            Read(
                connection.topic,
                connection.msgtype,
                log_time,
                reader.deserialize(raw, connection.msgtype),
            )
            for connection, log_time, raw in reader.messages()
        ]


def records(path: Path) -> Iterator[McapRecord]:
    """All records up to the point where the file is cut."""
    with path.open("rb") as file, contextlib.suppress(EndOfFile, struct.error, ZstdError):
        yield from StreamReader(file, validate_crcs=True).records


def attachments(path: Path) -> dict[str, bytes]:
    """Contents of the attachments by name."""
    return {each.name: each.data for each in records(path) if isinstance(each, Attachment)}


def raw_messages(path: Path, topic: str) -> list[Message]:
    """Messages of a topic up to the point where the file is cut."""
    channels: set[int] = set()
    found: list[Message] = []
    for record in records(path):
        if isinstance(record, Channel) and record.topic == topic:
            channels.add(record.id)
        elif isinstance(record, Message) and record.channel_id in channels:
            found.append(record)
    return found


def state_event(message: Any) -> NodeStateChanged | ContainerStateChanged | ProcessEvent:
    """The event that a ``play_launch_msgs/StateEvent`` records."""
    stamp_ns = message.stamp.sec * 1_000_000_000 + message.stamp.nanosec
    outcome: dict[str, Any] = {
        "cause": Cause(message.cause),
        "sequel": Sequel(message.sequel),
        "delay_ns": message.delay_ns,
        "culprit": message.culprit,
    }
    if message.kind == message.NODE:
        key = NodeKey(message.container, message.name)
        assert message.key == str(key)
        return NodeStateChanged(
            stamp_ns=stamp_ns,
            key=key,
            state=NodeState[message.state.upper()],
            elapsed_ns=message.elapsed_ns,
            reason=message.reason,
            pid=message.pid,
            cpu_time_ns=message.cpu_time_ns,
            unique_id=message.unique_id,
            attempt=message.attempt,
            crashes=message.crashes,
            reloads=message.restarts,
            **outcome,
        )
    if message.kind == message.CONTAINER:
        return ContainerStateChanged(
            stamp_ns=stamp_ns,
            container=message.key,
            state=ContainerState[message.state.upper()],
            reason=message.reason,
            mechanism=message.mechanism,
            **outcome,
        )
    assert message.kind == message.PROCESS
    return ProcessEvent(
        stamp_ns=stamp_ns,
        kind=ProcessEventKind[message.state.upper()],
        name=message.key,
        pid=message.pid,
        start_time=message.start_time,
        exit_code=message.exit_code,
        signal=message.signal,
        restarts=message.restarts,
        message=message.reason,
        command=tuple(message.command),
        **outcome,
    )
