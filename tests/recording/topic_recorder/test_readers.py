"""Recorded topics, read message by message with three readers that nobody here wrote."""

from __future__ import annotations

import asyncio
import json
import os
import re
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
MODULES = "PLAY_LAUNCH_NODE_MODULES"
"""Environment variable: a folder with `node_modules`, instead of asking npm for them."""
NO_WAY = (
    "ECONNREFUSED|ECONNRESET|EHOSTUNREACH|ENETUNREACH|ENOTFOUND|EAI_AGAIN|ETIMEDOUT|ENOTCACHED|"
    "ERR_SOCKET_TIMEOUT"
)
"""npm's codes for a registry that it does not reach."""


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


@pytest.fixture(scope="session")
def node_modules(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with what the reader in JavaScript imports."""
    if shutil.which("node") is None:
        pytest.skip("not on this machine: node, which runs the reader in JavaScript")
    if MODULES in os.environ:
        return Path(os.environ[MODULES])
    npm = shutil.which("npm")
    if npm is None:
        pytest.skip(f"not on this machine: npm; or name a folder of its packages in {MODULES}")
    folder = tmp_path_factory.mktemp("node")
    for name in ("package.json", NODE_READER.name):
        shutil.copy(NODE_READER.with_name(name), folder)
    # Errors come out with their code, and none is tried again: a machine without network says so
    # at once.
    install = [npm, "install", "--prefer-offline", "--no-audit", "--no-fund", "--loglevel=error"]
    result = subprocess.run(
        [*install, "--fetch-retries=0"],
        cwd=folder,
        check=False,
        capture_output=True,
        text=True,
        timeout=120,
    )
    if result.returncode != 0:
        if is_unreachable(result.stderr):
            pytest.skip("npm does not reach its registry, which the reader in JavaScript needs")
        pytest.fail(f"npm cannot install what the reader in JavaScript needs: {result.stderr}")
    return folder


def is_unreachable(stderr: str) -> bool:
    """Whether npm says that there is no way to its registry."""
    said = rf"^npm (?:ERR!|error) (?:code|errno) (?:{NO_WAY})$"
    return re.search(said, stderr, re.MULTILINE) is not None


@pytest.mark.parametrize(
    ("stderr", "expected"),
    [
        ("npm ERR! code ECONNREFUSED\nnpm ERR! syscall connect\n", True),
        ("npm error code EAI_AGAIN\nnpm error syscall getaddrinfo\n", True),
        ("npm error code E404\nnpm error 404 no package ENOTFOUND\n", False),
        ("npm ERR! code EINTEGRITY\n", False),
        ("", False),
    ],
)
def test_only_a_registry_out_of_reach_is_a_reason_to_skip(stderr: str, expected: bool) -> None:
    assert is_unreachable(stderr) is expected


def test_mcap_and_foxglove_in_javascript(bag: Path, node_modules: Path) -> None:
    if not (node_modules / NODE_READER.name).exists():
        shutil.copy(NODE_READER, node_modules)
    result = subprocess.run(
        ["node", NODE_READER.name, str(bag), *SENT],
        cwd=node_modules,
        check=True,
        capture_output=True,
        text=True,
        timeout=60,
    )
    read = [Seen(**json.loads(line)) for line in result.stdout.splitlines()]
    assert sorted(each for each in read if each.size) == EXPECTED
