"""Topics of real nodes, recorded by the real program and read back."""

from __future__ import annotations

import asyncio
import os
import signal
import threading
from collections.abc import Iterator
from itertools import dropwhile
from pathlib import Path
from typing import Any

import psutil
import pytest
from mcap.records import Channel, Metadata
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import Image, PointCloud2, PointField
from std_msgs.msg import String

from play_launch.container.ros import NotInstalledError
from play_launch.recording.errors import SchemaNotFoundError
from play_launch.recording.topic_recorder import SnapshotError, supervision
from play_launch.recording.topic_recorder.link import Kind, packet
from play_launch.recording.topics import message_definition
from play_launch.ros.fastdds.shared_memory import sweep
from tests.recording.reading import raw_messages, records
from tests.recording.topic_recorder.recording import (
    TIMEOUT,
    acknowledged,
    configuration,
    heard,
    held_up,
    publish_all,
    recording,
    until,
)
from tests.support.ros import Probe

pytestmark = pytest.mark.anyio

LATCHED = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
BEST_EFFORT = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)


@pytest.fixture
def swept() -> Iterator[None]:
    """For tests that kill the program; to be named before the probe, which holds what is left."""
    yield
    sweep()


@pytest.fixture
def probe() -> Iterator[Probe]:
    with Probe("source") as made:
        yield made


def strings(count: int, size: int = 0) -> list[String]:
    return [String(data=f"{number} {'x' * size}") for number in range(count)]


def cloud(number: int) -> PointCloud2:
    fields = [
        PointField(name=name, offset=4 * index, datatype=PointField.FLOAT32, count=1)
        for index, name in enumerate("xyz")
    ]
    data = bytes((number + index) % 256 for index in range(12 * 1000))
    message = PointCloud2(
        height=1, width=1000, fields=fields, point_step=12, row_step=12_000, data=data
    )
    message.header.frame_id = f"lidar {number}"
    return message


def image(number: int) -> Image:
    pixels = bytes([number]) * (640 * 480 * 3)
    return Image(height=480, width=640, encoding="rgb8", step=640 * 3, data=pixels)


def recorded(path: Path, topic: str, type_: Any = String) -> list[Any]:
    """Read what was recorded after the greetings, which are empty messages."""
    read = [deserialize_message(each.data, type_) for each in raw_messages(path, topic)]
    return list(dropwhile(lambda message: message == type_(), read))


def void(_: object) -> None:
    """For what returns something where nothing is to be returned."""


def channels(path: Path, topic: str) -> set[int]:
    found = (each for each in records(path) if isinstance(each, Channel))
    return {each.id for each in found if each.topic == topic}


async def test_topics_that_appear_later(probe: Probe, tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    early = probe.node.create_publisher(String, "/early", 10)
    async with recording(path, "{topics: ['*'], exclude: [/late/b]}") as made:
        await heard(made, early, String())
        late = probe.node.create_publisher(String, "/late/a", 10)
        left_out = [
            probe.node.create_publisher(String, name, 10) for name in ("/late/b", "/late/_hidden")
        ]
        await heard(made, late, String())
        await publish_all(late, strings(3))
        await acknowledged(late)
        assert not any(each.get_subscription_count() for each in left_out)
    assert recorded(path, "/late/a") == strings(3)


async def test_what_was_said_before_on_latched_topics(probe: Probe, tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    latched = probe.node.create_publisher(String, "/map", LATCHED)
    await publish_all(latched, strings(3))
    async with recording(path, "{topics: [/map]}") as made:
        await made.has(3)
    assert recorded(path, "/map") == strings(3)
    (offered,) = {
        each.metadata["offered_qos_profiles"]
        for each in records(path)
        if isinstance(each, Channel) and each.topic == "/map"
    }
    assert "reliability: 1\n  durability: 1\n" in offered


async def test_a_publisher_of_less_quality_is_heard_as_well(probe: Probe, tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    reliable = probe.node.create_publisher(String, "/mixed", LATCHED)
    async with recording(path, "{topics: [/mixed]}") as made:
        await heard(made, reliable, String())
        unreliable = probe.node.create_publisher(String, "/mixed", BEST_EFFORT)
        greetings, counted = 200, made.recorder.messages

        def is_heard() -> bool:
            unreliable.publish(String(data="unreliable"))
            return counted["/mixed"] > greetings

        # There were fewer of them, so the others are of the unreliable publisher.
        await until(is_heard, "its messages")
    assert String(data="unreliable") in recorded(path, "/mixed")


async def test_a_budget(probe: Probe, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / "x.mcap"
    flood = probe.node.create_publisher(String, "/flood", 100)
    calm = probe.node.create_publisher(String, "/calm", 100)
    async with recording(path, "{topics: [/flood, /calm], budget: 10 kB}") as made:
        await heard(made, flood, String())
        await heard(made, calm, String())
        await publish_all(flood, strings(100, size=1000), 0.001)
        await publish_all(calm, strings(20))
        await acknowledged(flood)
        await acknowledged(calm)
    kept = recorded(path, "/flood")
    assert made.summary is not None
    assert 9 <= len(kept) < 100
    assert len(kept) + made.summary.topic_drops == 100
    assert recorded(path, "/calm") == strings(20)
    drops = [each.metadata for each in records(path) if isinstance(each, Metadata)]
    assert {"/flood": str(100 - len(kept))} in drops
    assert "/flood" in caplog.text
    assert "exceed its budget" in caplog.text


async def test_a_budget_of_some_topics(probe: Probe, tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    flood = probe.node.create_publisher(String, "/flood", 100)
    free = probe.node.create_publisher(String, "/free", 100)
    record = "{topics: [/flood, /free], budget: {'/fl*': 10 kB, /free: never, '*': 1 B}}"
    async with recording(path, record) as made:
        await heard(made, flood, String())
        await heard(made, free, String())
        for each in (flood, free):
            await publish_all(each, strings(100, size=1000), 0.001)
            await acknowledged(each)
    assert 9 <= len(recorded(path, "/flood")) < 100
    assert recorded(path, "/free") == strings(100, size=1000)


async def test_a_type_that_is_not_installed(
    probe: Probe, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    def missing(name: str) -> str:
        if name == "std_msgs/msg/String":
            raise SchemaNotFoundError(name)
        return message_definition(name)

    path = tmp_path / "x.mcap"
    probe.node.create_publisher(String, "/unknown", 10)
    known = probe.node.create_publisher(Image, "/known", 10)
    async with recording(path, "{topics: [/unknown, /known]}", missing) as made:
        await heard(made, known, Image())
        await until(lambda: "/unknown is not recorded" in caplog.text, "the warning")
    assert caplog.text.count("/unknown is not recorded") == 1


async def test_a_topic_that_gets_another_type(
    probe: Probe, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "x.mcap"
    publisher = probe.node.create_publisher(String, "/changes", 10)
    async with recording(path, "{topics: [/changes]}") as made:
        await heard(made, publisher, String())
        with Probe("another") as another:
            another.node.create_publisher(Image, "/changes", 10)
            await until(lambda: "/changes has several types" in caplog.text, "the warning")
        await publish_all(publisher, strings(3))
        await acknowledged(publisher)
    assert caplog.text.count("/changes has several types") == 1
    assert "only std_msgs/msg/String is recorded" in caplog.text
    assert recorded(path, "/changes") == strings(3)


async def test_a_topic_that_is_only_measured_has_several_types(
    probe: Probe, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    probe.node.create_publisher(String, "/mixed", 10)
    with Probe("another") as another:
        another.node.create_publisher(Image, "/mixed", 10)
        expected = "{topics: []}\nexpect: {/mixed: {min_rate: 1}}"
        async with recording(tmp_path / "x.mcap", expected):
            await until(lambda: "/mixed" in caplog.text, "the warning")
    assert "topic /mixed is not measured: it has several types" in caplog.text


async def test_log_times_of_a_topic_do_not_go_back(probe: Probe, tmp_path: Path) -> None:
    # The middleware gives the messages of several publishers by turns, not as they arrived.
    path = tmp_path / "x.mcap"
    qos = QoSProfile(depth=500, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    publishers = [probe.node.create_publisher(String, "/latched", qos) for _ in range(5)]
    for publisher in publishers:
        await publish_all(publisher, strings(500, 500))
    async with recording(path, "{topics: [/latched]}") as made:
        while made.recorder.topic_messages < 4000:
            for publisher in publishers:
                publisher.publish(String(data="new"))
            await asyncio.sleep(0.0005)
    times = [each.log_time for each in raw_messages(path, "/latched")]
    assert times == sorted(times)


async def test_it_is_started_again(
    swept: None, probe: Probe, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "x.mcap"
    texts = probe.node.create_publisher(String, "/chatter", 100)
    async with recording(path, "{topics: [/chatter]}") as made:
        await heard(made, texts, String())
        first = made.pid
        os.kill(first, signal.SIGKILL)
        await until(lambda: made.pid != first, "its restart")
        # A publisher that writes meanwhile may be lost: docs/dds.md.
        readers = probe.node.get_subscriptions_info_by_topic
        await until(
            lambda: any(each.node_name.endswith(f"_{made.pid}") for each in readers("/chatter")),
            "its subscription",
        )
        await heard(made, texts, String())
        await publish_all(texts, strings(5))
        await heard(made, texts, String(data="end"))
    after = list(dropwhile(lambda message: not message.data, recorded(path, "/chatter")))
    assert [each for each in after if each.data != "end"] == strings(5)
    assert caplog.text.count("SIGKILL") == 1
    assert len(channels(path, "/chatter")) == 1, (
        "the second program goes on in the channel of the first"
    )


async def test_a_supervisor_that_does_not_go_on(probe: Probe, tmp_path: Path) -> None:
    # Its thread hangs, as on a disk that does not answer.
    path = tmp_path / "x.mcap"
    images = probe.node.create_publisher(Image, "/camera/image", 200)
    async with recording(path, "{topics: [/camera/image]}") as made:
        await heard(made, images, Image())
        gate = threading.Event()
        made.recorder.after_these(lambda: void(gate.wait(TIMEOUT)))
        process = psutil.Process(made.pid)
        await publish_all(images, [image(n % 256) for n in range(150)], 0.005)
        await acknowledged(images)
        memory = process.memory_info().rss
        gate.set()
        await publish_all(images, [image(255)], 0.01)
        await acknowledged(images)
    count = len(recorded(path, "/camera/image", Image))
    assert made.summary is not None
    assert 60 <= count < 151, "64 MiB of them wait"
    assert count + made.summary.topic_drops == 151
    assert memory < 250e6


async def test_what_has_arrived_by_the_end_is_recorded(probe: Probe, tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    texts = probe.node.create_publisher(String, "/chatter", 1000)
    async with recording(path, "{topics: [/chatter]}") as made:
        await heard(made, texts, String())
        assert made.topics._link is not None
        with held_up(made.pid):
            await publish_all(texts, strings(900))
            await acknowledged(texts)
            made.topics._link.send(packet(Kind.STOP))
    assert recorded(path, "/chatter") == strings(900)


async def test_it_ends_in_order_when_the_supervisor_is_gone(probe: Probe, tmp_path: Path) -> None:
    # Its last chunks are never written.
    images = probe.node.create_publisher(Image, "/camera/image", 200)
    async with recording(tmp_path / "x.mcap", "{topics: [/camera/image]}") as made:
        await heard(made, images, Image())
        gate = threading.Event()
        made.recorder.after_these(lambda: void(gate.wait(TIMEOUT)))
        await publish_all(images, [image(number) for number in range(20)], 0.005)
        child, link = made.topics._child, made.topics._link
        assert child is not None
        assert link is not None
        link.close()
        async with asyncio.timeout(4.5):  # it may wait for 5 s at the end of a run
            ended = await child.gone()
        gate.set()
    assert str(ended) == "exited with status 0"


async def test_an_installation_without_the_program(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    def missing() -> Path:
        raise NotInstalledError("the program topic_recorder is not there")

    monkeypatch.setattr(supervision, "topic_recorder", missing)
    async with recording(tmp_path / "x.mcap", "{}") as made:
        await made.topics.run()
        with pytest.raises(SnapshotError, match="not being recorded"):
            await made.topics.take("test")
    assert "topics of ROS are not recorded: the program topic_recorder" in caplog.text


@pytest.mark.parametrize(
    ("record", "arguments"),
    [
        ("{}", ""),
        (
            "{topics: [/a], exclude: [/rosout], budget: 1 kB}",
            "--topic /a --exclude /rosout --budget 1000",
        ),
        (
            "{budget: {/a: never, 'b*': 1.5 kB}}",
            "--topic-budget /a=0 --topic-budget /b*=1500",
        ),
        (
            "{before_crash: {topics: ['/b*'], seconds: 1.5, megabytes: 3}}",
            "--held /b* --hold-time 1500000000 --hold-size 3000000",
        ),
    ],
)
async def test_its_command_line(record: str, arguments: str) -> None:
    config = await asyncio.to_thread(configuration, record)
    argv = supervision.recorder_argv(Path("/bin/topic_recorder"), config, 7, -5)
    defaults = ["--topic", "/rosout", "--topic", "/diagnostics", "--topic", "/parameter_events"]
    assert argv[:5] == ("/bin/topic_recorder", "--socket", "7", "--clock-offset", "-5")
    assert argv[5:] == (*defaults, *arguments.split())
