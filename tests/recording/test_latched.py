"""Latched topics of ROS are in each file."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from play_launch.config.model import RotateConfig
from play_launch.container.cdr.messages import NODE_PARAMETERS
from play_launch.postmortem.bag_reader import BagReader
from play_launch.recording.bag import BagWriter, is_latched
from play_launch.recording.topics import PARAMETERS, STATES, Topic
from tests.recording.reading import raw_messages
from tests.recording.test_topic_chunks import append

if TYPE_CHECKING:
    from pathlib import Path

STRING = "std_msgs/msg/String"
LATCHED = STATES.offered_qos_profiles
VOLATILE = LATCHED.replace("durability: 1", "durability: 2")
FOR_TEN_SECONDS = LATCHED.replace("lifespan: {sec: 9223372036", "lifespan: {sec: 10")


@pytest.mark.parametrize(
    ("offered", "expected"),
    [
        (LATCHED, True),
        (f"{LATCHED}\n{LATCHED}", True),
        (VOLATILE, False),
        (f"{LATCHED}\n{VOLATILE}", False),
        (FOR_TEN_SECONDS, False),  # /rosout
        ("", False),
    ],
)
def test_what_is_latched(offered: str, expected: bool) -> None:
    assert is_latched(offered) is expected


def test_each_file_has_the_latest_messages_and_together_they_are_read_once(tmp_path: Path) -> None:
    writer = BagWriter(tmp_path / "session.mcap", rotation=RotateConfig(size=1))
    one = writer.register(Topic("/tf_static", STRING, offered=LATCHED))
    two = writer.register(Topic("/image", STRING, offered=VOLATILE))
    for messages in (
        [(one, 1, b"wheel"), (two, 2, b"first"), (one, 3, b"camera")],
        [(two, 4, b"second")],
        [(two, 5, b"third"), (one, 6, b"arm")],
    ):
        append(writer, messages)
    writer.close()
    latched = {}
    for number in ("", "_1", "_2", "_3"):
        path = tmp_path / f"session{number}.mcap"
        latched[number] = [each.data for each in raw_messages(path, "/tf_static")]
    assert latched == {
        "": [b"wheel", b"camera"],
        "_1": [b"wheel", b"camera"],
        "_2": [b"wheel", b"camera", b"arm"],
        "_3": [b"wheel", b"camera", b"arm"],
    }
    reader = BagReader(tmp_path)
    read = [message.data for message in reader.messages()]
    assert read == [b"wheel", b"first", b"camera", b"second", b"third", b"arm"]
    assert writer.messages == 6


def test_each_file_has_the_latest_parameters_of_each_node(tmp_path: Path) -> None:
    def answer(node: str, stamp: int) -> bytes:
        return NODE_PARAMETERS.write({"stamp": stamp, "node": node})

    writer = BagWriter(tmp_path / "session.mcap", rotation=RotateConfig(size=1))
    channel = writer.register(PARAMETERS)
    for messages in (
        [(channel, 1, answer("/a", 1)), (channel, 2, answer("/b", 2))],
        [(channel, 3, answer("/a", 3)), (channel, 4, b"no message")],
        [(channel, 5, answer("/c", 5))],
    ):
        append(writer, messages)
    writer.close()
    last = raw_messages(tmp_path / "session_3.mcap", PARAMETERS.name)
    assert [each.data for each in last] == [answer("/a", 3), answer("/b", 2), answer("/c", 5)]
    assert len(list(BagReader(tmp_path).messages())) == 5


def test_large_ones_and_many_are_limited(tmp_path: Path) -> None:
    writer = BagWriter(tmp_path / "session.mcap", rotation=RotateConfig(size=3_000_000))
    for name in ("/map", "/x"):
        writer.register(Topic(name, STRING, offered=LATCHED))
    for number in range(1, 4):
        append(writer, [(1, number, bytes(1_100_000)), *[(2, number, b"x")] * 60])
    writer.close()
    repeated = [len(raw_messages(tmp_path / "session_1.mcap", name)) for name in ("/map", "/x")]
    assert repeated == [1, 100]
