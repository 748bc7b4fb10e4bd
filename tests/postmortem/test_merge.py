"""Recordings of several machines as one."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

from play_launch.postmortem.bag_reader import BagReader
from play_launch.postmortem.merge import MergeError, Source, merge
from play_launch.recording.bag import BagWriter
from play_launch.recording.clock import CLOCK_METADATA
from play_launch.recording.folder import PartFile, parts_of
from play_launch.recording.topics import MACHINES_METADATA, STATES


def recording(path: Path, topic: str, times: list[int]) -> Path:
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        channel = writer.register_channel(topic, "cdr", schema, {"key": topic})
        writer.add_attachment(1, 1, f"config{topic.replace('/', '.')}", "text/plain", b"x")
        for number, time in enumerate(times):
            writer.add_message(channel, time, topic.encode(), time, number)
        writer.finish()
    return path


def source(machine: str, path: Path, *offsets: tuple[int, int]) -> Source:
    return Source(machine, [PartFile(path, 0)], offsets)


def test_messages_come_in_the_order_of_one_clock(tmp_path: Path) -> None:
    here = recording(tmp_path / "here.mcap", "/a", [100, 300])
    there = recording(tmp_path / "there.mcap", "/b", [1150, 1350])
    sources = [source("", here), source("vision", there, (0, 1000))]
    assert merge(sources, tmp_path / "out.mcap") == 4
    with (tmp_path / "out.mcap").open("rb") as file:
        reader = make_reader(file)
        found = [(c.topic, m.log_time, m.publish_time) for _, c, m in reader.iter_messages()]
        assert found == [
            ("/a", 100, 100),
            ("/b", 150, 150),
            ("/a", 300, 300),
            ("/b", 350, 350),
        ]
        (metadata,) = reader.iter_metadata()
        assert (metadata.name, metadata.metadata["vision"]) == (MACHINES_METADATA, "1000")
        assert [each.name for each in reader.iter_attachments()] == ["config.a"]
        # One schema, whatever the number of files.
        summary = reader.get_summary()
        assert summary is not None
        assert len(summary.schemas) == 1


def test_offsets_hold_evenly_between_their_measurements() -> None:
    source = Source("vision", [], [(1000, 100), (2000, 300)])
    assert [source.ahead(time) for time in (0, 1000, 1500, 2000, 9000)] == [100, 100, 200, 300, 300]
    assert Source("", [], []).ahead(5) == 0


def ends(reader: BagReader) -> list[bytes]:
    return [each.data[1_000_000:] for each in reader.messages()]


def test_several_files_become_one_and_those_that_were_removed_are_counted(tmp_path: Path) -> None:
    """Each file begins with the latest messages of those before, which the result has once."""
    sources, noise = [], os.urandom(1_000_000)
    for machine in ("", "vision"):
        (tmp_path / machine).mkdir(exist_ok=True)
        bag = BagWriter(tmp_path / machine / "session.mcap", limit=4e6, has_index=True)
        bag.attach("config.yaml", "application/yaml", b"name: robot", time=1)
        states = bag.register(STATES)
        for number in range(1, 13):
            data = noise + str(number).encode()
            bag.write(states, data, log_time=number, publish_time=number, key="/c")
            bag.flush()
        bag.close()
        assert bag.removed_parts > 2
        sources.append(Source(machine, parts_of(tmp_path / machine), []))
    kept = ends(BagReader(tmp_path))
    assert merge(sources, tmp_path / "out.mcap") == 2 * len(kept)

    merged = BagReader(tmp_path / "out.mcap")
    assert sorted(ends(merged)) == sorted(2 * kept)
    assert (merged.damages, list(merged.attachments)) == ([], ["config.yaml"])
    assert [each.count for each in merged.channels.values()] == [2 * len(kept)]
    (note,) = merged.notes
    assert note.startswith(f"{2 * bag.removed_parts} files")
    # Of a file that is missing, the next one has the latest message.
    sources[1].files[-2].path.unlink()
    sources[1] = Source("vision", parts_of(tmp_path / "vision"), [])
    merge(sources, tmp_path / "out.mcap")
    assert sorted(ends(BagReader(tmp_path / "out.mcap"))) == sorted([*kept, kept[-1]])


def test_publish_times_follow_no_clock_that_was_set(tmp_path: Path) -> None:
    jump, path = 400 * 86_400 * 10**9, tmp_path / "there.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        channel = writer.register_channel("/map", "cdr", schema)
        # Before and after the clock was set, and a latched one that is an hour old.
        for log_time, published in (
            (10**13, 10**13),
            (10**13 + 5, 10**13 + jump),
            (10**13, 10**12),
        ):
            writer.add_message(channel, log_time, b"", published)
        writer.add_metadata(CLOCK_METADATA, {"ahead_ns": str(jump)})
        writer.finish()
    merge([source("vision", path, (0, 1000))], tmp_path / "out.mcap")
    with (tmp_path / "out.mcap").open("rb") as file:
        found = [message.publish_time for _, _, message in make_reader(file).iter_messages()]
    assert sorted(found) == [10**12 - 1000, 10**13 - 1000, 10**13 - 1000]


def test_what_cannot_be_read_is_named_with_the_fix(tmp_path: Path) -> None:
    here = recording(tmp_path / "here.mcap", "/a", [100])
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(here.read_bytes()[:60])
    with pytest.raises(MergeError, match=r"broken.mcap: .*; `play-launch recover"):
        merge([source("", here), source("vision", broken)], tmp_path / "out.mcap")
