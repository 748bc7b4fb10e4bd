"""What is held in memory, and when it is written: by the program, and in a whole run."""

from __future__ import annotations

import asyncio
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest
from std_msgs.msg import String

from play_launch.recording.bag import BagWriter
from play_launch.recording.topic_recorder import SnapshotError
from play_launch.ros.fastdds.shared_memory import sweep
from tests.recording.reading import messages, raw_messages
from tests.recording.topic_recorder.recording import (
    acknowledged,
    held_up,
    publish_all,
    recording,
    until,
)
from tests.support.replay import COMMAND, Replay, alive, named, replaying
from tests.support.ros import Probe

HELD = "{before_crash: {topics: [/held], seconds: 60 s, megabytes: 8}}"
RUN = """
version: 1
name: held
record:
  topics: [/chatter]
  before_crash: {topics: [/images]}
containers:
  - name: lab
    container_type: isolated
    composable_nodes:
      - package: play_launch_demo
        plugin: play_launch_demo::Talker
        name: talker
        parameters: {rate: 50.0}
      - package: play_launch_demo
        plugin: play_launch_demo::ImageSource
        name: camera
        parameters: {rate: 20.0, bytes: 100000}
        remappings: {image: /images}
      - package: play_launch_demo
        plugin: play_launch_demo::Crasher
        name: unlucky
        parameters: {how: segv, after: CRASH}
        restart: {max_restarts: 0}
"""


@pytest.fixture
def probe() -> Iterator[Probe]:
    with Probe("source") as made:
        yield made


@pytest.mark.anyio
async def test_only_a_snapshot_writes_what_is_held(probe: Probe, tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    held = probe.node.create_publisher(String, "/held", 100)
    async with recording(path, HELD) as made:
        await until(lambda: held.get_subscription_count() > 0, "its subscription")
        for _ in range(50):
            await publish_all(held, [String(data="before")], 0.02)
        assert made.recorder.topic_messages == 0
        first = await made.topics.take("test")
        assert made.recorder.topic_messages == first.messages
        # It was passed on: nothing is written twice.
        assert (await made.topics.take("test")).messages == 0
        await publish_all(held, [String(data="after")] * 3)
        await asyncio.sleep(0.1)
    assert first.messages > 10
    assert 0.3 < first.seconds < 20
    texts = [each.message.data for each in messages(path) if each.topic == "/held"]
    assert texts == ["before"] * first.messages


@pytest.mark.anyio
async def test_a_snapshot_for_which_there_is_no_room_fails(
    probe: Probe, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(BagWriter, "leaves_room", lambda _bag, _more=0: False)
    held = probe.node.create_publisher(String, "/held", 100)
    async with recording(tmp_path / "x.mcap", HELD) as made:
        await until(lambda: held.get_subscription_count() > 0, "its subscription")
        for _ in range(50):
            await publish_all(held, [String(data="before")], 0.02)
        with pytest.raises(SnapshotError, match="messages of topics were dropped"):
            await made.topics.take("test")
        assert made.recorder.topic_messages == 0


@pytest.mark.anyio
async def test_what_has_arrived_is_in_the_snapshot(probe: Probe, tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    held = probe.node.create_publisher(String, "/held", 1000)
    async with recording(path, HELD) as made:
        await until(lambda: held.get_subscription_count() > 0, "its subscription")
        held.publish(String(data="first"))
        await acknowledged(held)
        with held_up(made.pid):
            await publish_all(held, [String(data=str(number)) for number in range(900)])
            await acknowledged(held)
            snapshot = asyncio.create_task(made.topics.take("test"))
            await asyncio.sleep(0)  # it is asked for
        await snapshot
    texts = [each.message.data for each in messages(path) if each.topic == "/held"]
    assert texts[-900:] == [str(number) for number in range(900)]


@pytest.mark.anyio
async def test_memory_is_bounded(probe: Probe, tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    held = probe.node.create_publisher(String, "/held", 100)
    async with recording(path, HELD) as made:
        await until(lambda: held.get_subscription_count() > 0, "its subscription")
        for number in range(200):
            await publish_all(held, [String(data=f"{number:03d}" + 100_000 * "x")], 0.002)
        await acknowledged(held)
        snapshot = await made.topics.take("test")
    assert 2_000_000 < snapshot.bytes <= 8_000_000
    kept = [each.message.data[:3] for each in messages(path) if each.topic == "/held"]
    assert kept == sorted(kept)
    assert kept[-1] == "199"


def loaded(replay: Replay) -> None:
    replay.read_until_states({"/talker": "loaded", "/camera": "loaded"})


def images(path: Path) -> int:
    return len(raw_messages(path, "/images"))


def wait_for_the_recorder(images: int = 5) -> None:
    """Wait until the recorder, and another node after it, hears the camera."""
    from sensor_msgs.msg import Image

    with Probe("beside") as probe:
        probe.spin_until(lambda: probe.node.count_subscribers("/images") > 0, 60, "the recorder")
        probe.collect(Image, "/images", images)


def test_a_crash_writes_what_was_held(tmp_path: Path) -> None:
    config = tmp_path / "run.yaml"
    config.write_text(RUN.replace("CRASH", "1000.0"), encoding="utf-8")

    def says_so(event: dict[str, Any]) -> bool:
        text = event.get("message", "")
        return event["event"] == "log" and "recorded" in text and "/unlucky" in text

    with replaying(config, tmp_path / "log") as replay:
        replay.read_until_states(dict.fromkeys(("/talker", "/camera", "/unlucky"), "loaded"))
        wait_for_the_recorder()
        (unlucky,) = named(replay.descendants(), "unlucky")
        unlucky.send_signal(signal.SIGSEGV)
        replay.read_until(says_so, "a line about what was held")
        replay.process.send_signal(signal.SIGINT)
        replay.read_all()
    assert images(replay.bag) >= 5
    assert raw_messages(replay.bag, "/chatter")
    assert raw_messages(replay.bag, "/rosout"), "one of the default topics"


def test_a_snapshot_writes_what_was_held(tmp_path: Path) -> None:
    config = tmp_path / "run.yaml"
    config.write_text(RUN.replace("CRASH", "1000.0"), encoding="utf-8")
    with replaying(config, tmp_path / "log") as replay:
        loaded(replay)
        wait_for_the_recorder()
        asked = [str(COMMAND), "snapshot", "--session", str(tmp_path / "log" / "latest")]
        result = subprocess.run(asked, check=True, capture_output=True, text=True, timeout=60)
        replay.process.send_signal(signal.SIGINT)
        replay.read_all()
    count = images(replay.bag)
    assert count >= 5
    assert f": {count} messages, " in result.stdout
    result = subprocess.run(asked, check=False, capture_output=True, text=True, timeout=60)
    assert result.returncode == 1
    assert "no session is running in" in result.stderr


def test_the_recorder_ends_with_a_supervisor_that_is_killed(tmp_path: Path) -> None:
    from std_msgs.msg import String

    config = tmp_path / "run.yaml"
    config.write_text(RUN.replace("CRASH", "1000.0"), encoding="utf-8")
    with replaying(config, tmp_path / "log") as replay:
        loaded(replay)
        wait_for_the_recorder()
        with Probe("listener") as probe:  # the last quarter of a second may be lost
            probe.collect(String, "/chatter", 10)
        everything = replay.descendants()
        assert named(everything, "topic_recorder")
        replay.process.kill()
        replay.process.wait()
        psutil.wait_procs(everything, timeout=60)
        assert not alive(everything)
    sweep()
    cut = next((tmp_path / "log").glob("*/session.mcap.active"))
    subprocess.run([str(COMMAND), "recover", str(cut)], check=False, timeout=60)
    talk = [each.message.data for each in messages(cut.with_suffix("")) if each.topic == "/chatter"]
    assert talk
    assert talk == sorted(talk, key=lambda text: int(text.rpartition(" ")[2]))


def test_it_can_be_switched_off(tmp_path: Path) -> None:
    config = tmp_path / "run.yaml"
    text = RUN.replace("CRASH", "1000.0").replace("record:", "record:\n  ros: false")
    config.write_text(text, encoding="utf-8")
    with replaying(config, tmp_path / "log") as replay:
        loaded(replay)
        replay.read_until(lambda event: "World: 51" in event.get("text", ""), "51 messages")
        assert not named(replay.descendants(), "topic_recorder")
        replay.process.send_signal(signal.SIGINT)
        replay.read_all()
    assert not raw_messages(replay.bag, "/rosout")
