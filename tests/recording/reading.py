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
