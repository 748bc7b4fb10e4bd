"""Recorded topics, read message by message with three independent readers."""

from __future__ import annotations

import asyncio
import json
import shutil
import subprocess
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from sensor_msgs.msg import Image, PointCloud2
from std_msgs.msg import String

from tests.recording.reading import raw_messages
from tests.recording.topic_recorder.recording import acknowledged, heard, publish_all, recording
from tests.recording.topic_recorder.test_recording import cloud, image, strings
from tests.support.ros import Probe

SENT = {
    "/chatter": strings(50),
    "/lidar/points": [cloud(number) for number in range(5)],
    "/camera/image": [image(number) for number in range(3)],
}
TYPES = {"/chatter": String, "/lidar/points": PointCloud2, "/camera/image": Image}
NODE_READER = Path(__file__).parent / "reader" / "read.mjs"


class Seen(NamedTuple):
    """What a reader says of a message."""

    topic: str
    kind: str
    size: int
    """Of its data, or of its text."""
    first: int
    """First byte of its data, or first number in its text."""
    frame: str


def seen(topic: str, message: Any) -> Seen:
    if topic == "/chatter":
        text = message.data
        return Seen(topic, "text", len(text), int(text.split()[0]), "")
    data = message.data
    return Seen(topic, "data", len(data), int(data[0]), message.header.frame_id)


EXPECTED = sorted(seen(topic, each) for topic, sent in SENT.items() for each in sent)


def is_greeting(topic: str, message: Any) -> bool:
    return not len(message.data)


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("readers") / "x.mcap"

    async def record() -> None:
        with Probe("source") as probe:
            publishers = {
                topic: probe.node.create_publisher(TYPES[topic], topic, 100) for topic in SENT
            }
            async with recording(path, "{topics: [/chatter, '/lidar/*', '/camera/*']}") as made:
                for topic, publisher in publishers.items():
                    await heard(made, publisher, TYPES[topic]())
                for topic, publisher in publishers.items():
                    await publish_all(publisher, SENT[topic], 0.002)
                    await acknowledged(publisher)

    asyncio.run(record())
    return path


def test_rosbags(bag: Path) -> None:
    with AnyReader([bag]) as reader:
        read = [
            (connection.topic, reader.deserialize(data, connection.msgtype))
            for connection, _, data in reader.messages()
            if connection.topic in SENT
        ]
    assert sorted(seen(*each) for each in read if not is_greeting(*each)) == EXPECTED


def test_mcap_ros2(bag: Path) -> None:
    with bag.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        read = [
            (channel.topic, message)
            for _, channel, _, message in reader.iter_decoded_messages(topics=list(SENT))
        ]
    assert sorted(seen(*each) for each in read if not is_greeting(*each)) == EXPECTED
    stamps = [(each.publish_time, each.log_time) for each in raw_messages(bag, "/chatter")]
    assert all(0 < published <= logged for published, logged in stamps)
    sequence = [each.sequence for each in raw_messages(bag, "/chatter")]
    assert sequence == list(range(1, len(sequence) + 1))


def test_mcap_and_foxglove_in_javascript(bag: Path) -> None:
    if shutil.which("node") is None:
        pytest.skip("not on this machine: node, which runs the reader in JavaScript")
    if not NODE_READER.with_name("node_modules").is_dir():
        pytest.skip("the reader in JavaScript has no packages here; `just readers` installs them")
    result = subprocess.run(
        ["node", NODE_READER, bag, *SENT],
        check=True,
        capture_output=True,
        text=True,
        timeout=60,
    )
    read = [Seen(**json.loads(line)) for line in result.stdout.splitlines()]
    assert sorted(each for each in read if each.size) == EXPECTED
