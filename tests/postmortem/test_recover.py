"""What can be read of a recording is written anew, and other readers take it."""

from __future__ import annotations

import signal
from typing import TYPE_CHECKING

import pytest
from rosbags.highlevel import AnyReader

from play_launch.postmortem.archive import is_being_written
from play_launch.postmortem.bag_reader import BagReader
from play_launch.postmortem.recover import RecoverError, default_output, recover
from play_launch.recording import topics
from play_launch.recording.bag import BagWriter
from play_launch.supervisor.events import OutputLine, RunEvent, Stream
from tests.postmortem.test_past_session import record
from tests.recording.reading import messages, raw_messages
from tests.support.replay import alive, replaying
from tests.support.waiting import until

if TYPE_CHECKING:
    from pathlib import Path

LINES: list[RunEvent] = [
    OutputLine(stamp_ns=number, process="/a", pid=7, stream=Stream.STDOUT, text=f"line {number}")
    for number in range(100)
]


def contents(reader: BagReader) -> list[tuple[object, ...]]:
    return [(m.topic, m.log_time, m.publish_time, m.data) for m in reader.messages()]


def texts(path: Path) -> list[str]:
    return [each.message.msg for each in messages(path)]


def test_a_whole_file_loses_nothing(tmp_path: Path) -> None:
    bag = record(tmp_path / "x.mcap", LINES)
    recovered = recover(bag, default_output(bag))
    assert recovered.path == tmp_path / "x.recovered.mcap"
    assert (recovered.messages, recovered.reader.damages) == (100, [])
    assert texts(recovered.path) == [f"line {number}" for number in range(100)]
    again = BagReader(recovered.path)
    assert contents(again) == contents(BagReader(bag))
    assert again.is_complete
    assert again.metadata == recovered.reader.metadata
    qos = {each.channel.metadata["offered_qos_profiles"] for each in again.channels.values()}
    assert qos == {topics.OUTPUT.offered_qos_profiles}


def test_a_cut_file_keeps_what_comes_before(tmp_path: Path) -> None:
    bag = record(tmp_path / "x.mcap", LINES)
    cut = tmp_path / "session.mcap.active"
    cut.write_bytes(bag.read_bytes()[:-2000])
    recovered = recover(cut, default_output(cut))
    assert recovered.path == tmp_path / "session.mcap"
    assert BagReader(recovered.path).damages == []
    assert cut.exists()
    with AnyReader([tmp_path]) as reader:  # it takes a folder with an index alone
        assert reader.message_count == recovered.messages
        assert [one.ros_distro for one in reader.readers] == ["jazzy"]  # type: ignore[union-attr]


def test_what_is_being_written_is_refused(tmp_path: Path) -> None:
    writer = BagWriter(tmp_path / "x.mcap")
    with pytest.raises(RecoverError, match="is being written by a running session"):
        recover(writer.path, tmp_path / "y.mcap")
    writer.abandon()
    recover(writer.path, tmp_path / "y.mcap")


def test_nothing_is_overwritten_and_nothing_half_is_left(tmp_path: Path) -> None:
    bag = record(tmp_path / "x.mcap", LINES)
    before = bag.read_bytes()
    with pytest.raises(RecoverError, match="exists; name another file"):
        recover(bag, bag)
    assert bag.read_bytes() == before
    (tmp_path / "no.mcap").write_text("nothing")
    with pytest.raises(RecoverError, match="not an MCAP file"):
        recover(tmp_path / "no.mcap", tmp_path / "z.mcap")
    with pytest.raises(RecoverError, match="No such file"):
        recover(bag, tmp_path / "nowhere" / "z.mcap")
    recover(bag, tmp_path / "elsewhere.mcap")
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == ["elsewhere.mcap", "no.mcap", "x.mcap"], "no index of what is no session"


CONFIG = """
version: 1
name: killed
containers:
  - name: chat
    composable_nodes:
      - {package: play_launch_demo, plugin: "play_launch_demo::Talker", name: talker}
"""


def test_the_recording_of_a_killed_supervisor_is_recovered(tmp_path: Path) -> None:
    config = tmp_path / "killed.yaml"
    config.write_text(CONFIG, encoding="utf-8")
    with replaying(config, tmp_path / "logs") as session:
        session.read_until_states({"/talker": "loaded"})
        active = session.bag.with_name("session.mcap.active")
        with pytest.raises(RecoverError, match="running session"):
            recover(active, session.bag)
        # What happened in the last moments is not on disk yet.
        until(lambda: bool(raw_messages(active, topics.STATES.name)), "a state in the recording")
        others = session.descendants()
        session.process.send_signal(signal.SIGKILL)
        session.process.wait()
        # A child that was being forked has its files, and their locks, until it executes a program.
        until(lambda: not is_being_written(active), "a file without a writer")
        recovered = recover(active, session.bag)
    assert recovered.reader.damages == []
    assert recovered.messages == len(messages(session.bag)) > 0
    assert recovered.reader.attachments.keys() >= {"config.yaml", "host.json"}
    import psutil

    psutil.wait_procs(others, timeout=60)
    assert alive(others) == []
