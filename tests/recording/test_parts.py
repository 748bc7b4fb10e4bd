"""A recording in several files: each can be read alone, all together are the whole."""

from __future__ import annotations

import errno
import os
from typing import TYPE_CHECKING

import pytest
from mcap.records import Attachment, Metadata, Schema
from rosbags.highlevel import AnyReader

from play_launch.config.model import RotateConfig
from play_launch.container.cdr.messages import log_message
from play_launch.recording.bag import BagWriter
from play_launch.recording.folder import MAGIC, part_path, parts_of
from play_launch.recording.forms import convert
from play_launch.recording.topics import OUTPUT, STATES, Topic, message_definition
from play_launch.supervisor.events import ContainerState, ContainerStateChanged
from tests.recording.reading import messages, raw_messages, records

if TYPE_CHECKING:
    from pathlib import Path


def write_line(writer: BagWriter, channel: int, number: int) -> None:
    data = log_message(number, 20, "/a", f"line {number}", file="stdout")
    writer.write(channel, data, log_time=number, publish_time=number)


def three_parts(folder: Path, *, has_index: bool = False) -> BagWriter:
    """Lines 1 to 6 in three files, and two states in the first one."""
    writer = BagWriter(
        folder / "session.mcap",
        rotation=RotateConfig(size=1),
        has_index=has_index,
        ros_distro="jazzy",
    )
    writer.attach("config.yaml", "application/yaml", b"a: 1\n", time=5)
    writer.metadata("play_launch.session", {"id": "1"})
    states, output = writer.register(STATES), writer.register(OUTPUT)
    for number, state in enumerate((ContainerState.STARTING, ContainerState.RUNNING)):
        event = ContainerStateChanged(stamp_ns=number, container="/c", state=state)
        ((_, data, key),) = convert(event)
        writer.write(states, data, log_time=1, publish_time=number, key=key)
    for number in range(1, 7):
        write_line(writer, output, number)
        if number in {2, 4}:
            writer.flush()
    writer.close()
    return writer


def test_each_file_is_complete_by_itself(tmp_path: Path) -> None:
    writer = three_parts(tmp_path)
    assert (writer.path, writer.parts, writer.messages) == (tmp_path, 3, 8)
    paths = [part_path(tmp_path / "session.mcap", number) for number in range(3)]
    assert sorted(tmp_path.iterdir()) == sorted(paths)
    assert writer.bytes_written == sum(path.stat().st_size for path in paths)
    for number, path in enumerate(paths):
        lines = [read.message.msg for read in messages(path) if read.topic == OUTPUT.name]
        assert lines == [f"line {2 * number + 1}", f"line {2 * number + 2}"]
        states = [read.message.state for read in messages(path) if read.topic == STATES.name]
        assert states == (["starting", "running"] if number == 0 else ["running"])
        latest = raw_messages(path, STATES.name)[-1]
        assert latest.publish_time == 1, "repeated with its own stamp"
        assert (latest.log_time > 10**18) == (number > 0), "and the time of its repetition"
        (attachment,) = [one for one in records(path) if isinstance(one, Attachment)]
        assert attachment.data == b"a: 1\n"
        metadata = {one.name: one.metadata for one in records(path) if isinstance(one, Metadata)}
        assert metadata.pop("play_launch.session") == {"id": "1"}
        part = {"number": str(number), "first": "0"}
        assert metadata == ({"play_launch.part": part} if number else {})


def recorded_with_limit(folder: Path, megabytes: float) -> BagWriter:
    """Lines 1 to 12 in files of one of them each, of 1 MB."""
    writer = BagWriter(folder / "session.mcap", limit=megabytes * 1e6, has_index=True)
    output = writer.register(OUTPUT)
    noise = os.urandom(1_000_000).hex()
    for number in range(1, 13):
        data = log_message(number, 20, "/a", f"line {number} {noise}", file="stdout")
        writer.write(output, data, log_time=number, publish_time=number)
        writer.flush()
    writer.close()
    return writer


def numbers(folder: Path) -> list[int]:
    return [part.number for part in parts_of(folder)]


def test_beyond_the_limit_the_oldest_files_go(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO")
    writer = recorded_with_limit(tmp_path, 4)
    kept = numbers(tmp_path)
    assert kept == list(range(kept[0], 12 + 1))
    size = sum(part.path.stat().st_size for part in parts_of(tmp_path))
    assert 2e6 < size <= 4e6
    assert (writer.parts, writer.removed_parts) == (len(kept), kept[0])
    assert writer.bytes_written == size
    with AnyReader([tmp_path]) as bag:
        lines = [
            vars(bag.deserialize(raw, connection.msgtype))["msg"].split()[1]
            for connection, _, raw in bag.messages()
        ]
    assert lines == [str(number) for number in range(kept[0] + 1, 13)]
    assert writer.messages == len(lines)
    assert sum("removed" in each.message for each in caplog.records) == kept[0]


def test_the_two_latest_files_stay_whatever_the_limit_is(tmp_path: Path) -> None:
    recorded_with_limit(tmp_path, 0.5)
    assert numbers(tmp_path) == [11, 12]


def test_nothing_of_a_session_that_is_pinned_goes(tmp_path: Path) -> None:
    (tmp_path / "pinned").touch()
    assert recorded_with_limit(tmp_path, 4).removed_parts == 0
    assert numbers(tmp_path) == list(range(13))


@pytest.mark.parametrize("change", ["int64 other\n", None])
def test_definitions_in_each_file_are_those_of_the_beginning(
    tmp_path: Path, change: str | None
) -> None:
    """The package of a type is built again, or removed, while the session runs."""
    file = tmp_path / "share" / "a_msgs" / "msg" / "Wheel.msg"
    file.parent.mkdir(parents=True)
    file.write_text("int32 left\n")
    writer = BagWriter(
        tmp_path / "x.mcap",
        rotation=RotateConfig(size=1),
        definition=lambda type_name: message_definition(type_name, (tmp_path,)),
    )
    channel = writer.register(Topic("/one", "a_msgs/msg/Wheel"))
    if change is None:
        file.unlink()
    else:
        file.write_text(change)
    for number in (1, 2):
        writer.write(channel, bytes(8), log_time=number, publish_time=number)
        writer.flush()
    writer.register(Topic("/another", "a_msgs/msg/Wheel"))
    writer.close()
    assert writer.parts == 3
    for number in range(3):
        schemas = [
            one.data
            for one in records(part_path(tmp_path / "x.mcap", number))
            if isinstance(one, Schema)
        ]
        assert set(schemas) == {b"int32 left\n"}


def test_the_folder_is_one_bag_to_others(tmp_path: Path) -> None:
    three_parts(tmp_path, has_index=True)
    with AnyReader([tmp_path]) as reader:
        assert reader.message_count == 10
        assert [one.ros_distro for one in reader.readers] == ["jazzy"]  # type: ignore[union-attr]
        counts = {each.topic: each.msgcount for each in reader.connections}
        lines = [
            reader.deserialize(raw, connection.msgtype).msg  # type: ignore[attr-defined]
            for connection, _, raw in reader.messages()
            if connection.topic == OUTPUT.name
        ]
    assert counts == {OUTPUT.name: 6, STATES.name: 4}
    assert lines == [f"line {number}" for number in range(1, 7)]


def test_a_file_ends_by_time_too(tmp_path: Path) -> None:
    writer = BagWriter(tmp_path / "x.mcap", rotation=RotateConfig(duration=1e-9))
    channel = writer.register(OUTPUT)
    write_line(writer, channel, 1)
    writer.flush()
    write_line(writer, channel, 2)
    writer.close()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["x.mcap", "x_1.mcap"]


def test_nothing_new_begins_no_file(tmp_path: Path) -> None:
    writer = BagWriter(tmp_path / "x.mcap", rotation=RotateConfig(size=1))
    channel = writer.register(STATES)
    event = ContainerStateChanged(stamp_ns=1, container="/c", state=ContainerState.RUNNING)
    ((_, data, key),) = convert(event)
    writer.write(channel, data, log_time=1, publish_time=1, key=key)
    for _ in range(5):
        writer.flush()
    assert writer.parts == 2
    writer.close()


def test_a_disk_that_is_full_when_another_file_begins_leaves_no_half_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    writer = BagWriter(tmp_path / "x.mcap", rotation=RotateConfig(size=1))
    channel = writer.register(OUTPUT)
    write_line(writer, channel, 1)
    really = os.pwrite

    def no_room_at_the_beginning(descriptor: int, data: bytes, at: int) -> int:
        if at == 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return really(descriptor, data, at)

    monkeypatch.setattr(os, "pwrite", no_room_at_the_beginning)
    writer.flush()
    assert [path.name for path in tmp_path.iterdir()] == ["x.mcap.active"]
    writer.close()
    assert len(messages(tmp_path / "x.mcap")) == 1


def test_a_file_without_room_for_its_summary_stays_active(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    writer = BagWriter(tmp_path / "x.mcap", rotation=RotateConfig(size=1))
    channel = writer.register(OUTPUT)
    write_line(writer, channel, 1)
    really = os.pwrite

    def no_room_for_a_summary(descriptor: int, data: bytes, at: int) -> int:
        if bytes(data).endswith(MAGIC):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return really(descriptor, data, at)

    monkeypatch.setattr(os, "pwrite", no_room_for_a_summary)
    writer.flush()
    monkeypatch.undo()
    write_line(writer, channel, 2)
    writer.close()
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == ["x.mcap.active", "x_1.mcap"]
    assert len(raw_messages(tmp_path / "x.mcap.active", OUTPUT.name)) == 1
    assert [read.message.msg for read in messages(tmp_path / "x_1.mcap")] == ["line 2"]
    assert "the next start completes it" in caplog.text
