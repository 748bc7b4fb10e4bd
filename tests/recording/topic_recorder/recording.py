"""Records with the real program, in this process, what a node of this process publishes."""

from __future__ import annotations

import asyncio
import contextlib
import ctypes
import os
import time
from collections import Counter
from collections.abc import AsyncIterator, Callable, Iterator
from pathlib import Path
from typing import Any

from rclpy.publisher import Publisher

from play_launch.config.load import parse_config
from play_launch.config.model import ReplayConfig
from play_launch.recording.bag import BagWriter
from play_launch.recording.chunk import TopicChunk
from play_launch.recording.limits import RecordingSummary
from play_launch.recording.recorder import Recorder
from play_launch.recording.topic_recorder.supervision import TopicRecording
from play_launch.recording.topics import message_definition

_PTRACE_SEIZE, _PTRACE_INTERRUPT, _PTRACE_DETACH = 0x4206, 0x4207, 17
_WALL = 0x40000000

TIMEOUT = 60.0
"""Seconds for anything to happen; only a failure takes as long."""


def configuration(record: str) -> ReplayConfig:
    text = f"version: 1\nnodes: [{{command: [x]}}]\nrecord: {record}\n"
    return parse_config(text.encode(), Path("demo.yaml"))


class CountingRecorder(Recorder):
    """Counts what of each topic is in the file."""

    def __init__(self, bag: BagWriter) -> None:
        self._names: dict[int, str] = {}
        self.messages: Counter[str] = Counter()
        self.published: Counter[str] = Counter()
        """Publish time of the newest message of a topic."""
        super().__init__(bag)

    def open_channel(
        self, name: str, type_name: str, offered_qos_profiles: str, answer: Callable[[int], None]
    ) -> None:
        def note(channel: int) -> None:
            self._names[channel] = name
            answer(channel)

        super().open_channel(name, type_name, offered_qos_profiles, note)

    def append_chunk(self, chunk: TopicChunk, done: Callable[[], None]) -> None:
        newest = [max(stamp for _, stamp in chunk.messages_of(part)) for part in chunk.parts]

        def count() -> None:
            for part, published in zip(chunk.parts, newest, strict=True):
                name = self._names[part.channel]
                self.messages[name] += part.messages
                self.published[name] = max(self.published[name], published)
            done()

        super().append_chunk(chunk, count)


class Recording:
    """A recording under way; its file is complete when the block is left."""

    def __init__(self, recorder: CountingRecorder, config: ReplayConfig) -> None:
        self.recorder = recorder
        self.topics = TopicRecording(config, recorder, lambda _measured: None, lambda _reason: None)
        self.summary: RecordingSummary | None = None

    @property
    def pid(self) -> int:
        """Of the program."""
        child = self.topics._child
        assert child is not None
        return child.pid

    async def has(self, messages: int) -> None:
        """Wait until so many are in the file."""
        recorder = self.recorder
        await until(lambda: recorder.topic_messages >= messages, f"{messages} messages in the file")


@contextlib.asynccontextmanager
async def recording(
    path: Path, record: str, definition: Callable[[str], str] = message_definition
) -> AsyncIterator[Recording]:
    config = await asyncio.to_thread(configuration, record)
    recorder = await asyncio.to_thread(
        lambda: CountingRecorder(BagWriter(path, definition=definition))
    )
    made = Recording(recorder, config)
    try:
        # A failure of it ends the test.
        async with asyncio.TaskGroup() as tasks:
            task = tasks.create_task(made.topics.run())
            yield made
            task.cancel()
    finally:
        made.summary = await asyncio.to_thread(made.recorder.close)


async def until(done: Callable[[], bool], what: str) -> None:
    """Wait for what has no event of its own: others' entries in the graph."""
    deadline = time.monotonic() + TIMEOUT
    while not done():
        assert time.monotonic() < deadline, f"waited {TIMEOUT} s for {what}"
        await asyncio.sleep(0.02)


async def heard(made: Recording, publisher: Publisher, hello: Any) -> None:
    """Wait until what this one publishes from now on is recorded; ``hello`` is the first of it.

    That a publisher has a subscription does not mean yet that this one knows the publisher.
    """
    topic, since = publisher.topic_name, time.time_ns()

    def is_heard() -> bool:
        publisher.publish(hello)
        return made.recorder.published[topic] > since

    await until(is_heard, f"messages of {topic} in the file")


async def publish_all(publisher: Publisher, messages: list[Any], pause: float = 0.0) -> None:
    for message in messages:
        publisher.publish(message)
        await asyncio.sleep(pause)


@contextlib.contextmanager
def held_up(pid: int) -> Iterator[None]:
    """Keep the first thread of a process from running; its others go on."""
    libc = ctypes.CDLL(None, use_errno=True)

    def trace(request: int) -> None:
        if libc.ptrace(request, pid, None, None) != 0:
            raise OSError(ctypes.get_errno(), f"ptrace({request:#x})")

    trace(_PTRACE_SEIZE)
    trace(_PTRACE_INTERRUPT)
    os.waitpid(pid, _WALL)
    try:
        yield
    finally:
        trace(_PTRACE_DETACH)


async def acknowledged(publisher: Publisher) -> None:
    """Wait until all that was sent reliably has arrived."""
    from rclpy.duration import Duration

    assert await asyncio.to_thread(publisher.wait_for_all_acked, Duration(seconds=TIMEOUT))
