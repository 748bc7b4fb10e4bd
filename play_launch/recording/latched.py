"""What holds until further notice, and is repeated at the beginning of each file."""

from __future__ import annotations

import os
import re
from collections import deque
from typing import TYPE_CHECKING, Final, NamedTuple

from play_launch.container.cdr.layout import Layout
from play_launch.recording.chunk import CHUNK_HEAD, ENTRY, INDEX, MESSAGE
from play_launch.recording.topics import PARAMETERS

if TYPE_CHECKING:
    from collections.abc import Iterator

    from play_launch.recording.chunk import ChannelPart, TopicChunk
    from play_launch.recording.topics import Topic

_MOST: Final = 100
"""Messages of a topic that are kept,"""
_MOST_BYTES: Final = 1024 * 1024
"""and their bytes; the latest message is kept in any case."""
_WHOSE: Final = Layout("stamp:t node:s")
"""How a message of `PARAMETERS` begins."""
_TRANSIENT_LOCAL: Final = re.compile(r"\bdurability: 1\b")
_FOR_EVER: Final = re.compile(r"\blifespan:\s*\{?\s*sec: (?:9223372036|2147483647)\b")


class Repeated(NamedTuple):
    """A message, as it stands in every file."""

    channel: int
    data: bytes
    publish_time: int


class Latched:
    """The latest message of each key or node, and the latest ones of latched topics of ROS.

    How many publishers a topic has, each with its own, is not known: of `/tf_static` all are kept
    that came, up to a number and a size.
    """

    def __init__(self) -> None:
        self._by_key: dict[tuple[int, str], Repeated] = {}
        self._by_topic: dict[int, deque[Repeated]] = {}

    def __len__(self) -> int:
        return len(self._by_key) + sum(map(len, self._by_topic.values()))

    def __iter__(self) -> Iterator[Repeated]:
        yield from self._by_key.values()
        for messages in self._by_topic.values():
            yield from messages

    def note(self, channel: int, key: str, data: bytes, publish_time: int) -> None:
        """Take a message in place of the last one with this key."""
        self._by_key[channel, key] = Repeated(channel, data, publish_time)

    def latest(self, channel: int, key: str) -> bytes | None:
        """Give the latest message with a key, or of a node; from any thread."""
        found = self._by_key.get((channel, key))
        return None if found is None else found.data

    def note_chunk(self, chunk: TopicChunk, topics: dict[int, Topic]) -> None:
        """Take the messages of latched topics in a chunk; may raise ``OSError``, ``CdrError``."""
        for part in chunk.parts:
            topic = topics.get(part.channel)
            if topic is not None and topic.name == PARAMETERS.name:
                for message in _messages(chunk, part):
                    self._by_key[part.channel, _WHOSE.read(message.data)["node"]] = message
            elif topic is not None and is_latched(topic.offered):
                kept = self._by_topic.setdefault(part.channel, deque())
                kept.extend(_messages(chunk, part))
                size = sum(len(message.data) for message in kept)
                while len(kept) > 1 and (size > _MOST_BYTES or len(kept) > _MOST):
                    size -= len(kept.popleft().data)


def is_latched(offered_qos_profiles: str) -> bool:
    """Whether all publishers keep their messages for late subscribers, without limit."""
    profiles = offered_qos_profiles.count("durability:")
    return (
        profiles > 0
        and len(_TRANSIENT_LOCAL.findall(offered_qos_profiles)) == profiles
        and len(_FOR_EVER.findall(offered_qos_profiles)) == profiles
    )


def _messages(chunk: TopicChunk, part: ChannelPart) -> Iterator[Repeated]:
    """The messages of a channel in a chunk, which is one of play-launch's own making."""
    at = part.index_offset + INDEX.size
    entries = os.pread(chunk.descriptor, ENTRY.size * part.messages, at)
    for _, place in ENTRY.iter_unpack(entries):
        head = os.pread(chunk.descriptor, MESSAGE.size, CHUNK_HEAD + place)
        _, length, channel, _, _, publish_time = MESSAGE.unpack(head)
        data = os.pread(
            chunk.descriptor,
            length - (MESSAGE.size - 9),
            CHUNK_HEAD + place + MESSAGE.size,
        )
        yield Repeated(channel, data, publish_time)
