"""A session in several files is read as one."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from play_launch.config.model import RotateConfig
from play_launch.postmortem.bag_reader import BagReader, NotARecordingError
from play_launch.postmortem.past_session import PastSession
from play_launch.recording import topics
from play_launch.recording.bag import BagWriter
from play_launch.recording.forms import convert
from play_launch.recording.topics import METADATA_NAME
from play_launch.supervisor.events import ContainerStateChanged, RunEvent
from tests.postmortem.test_past_session import OTHERS
from tests.recording.test_parts import recorded_with_limit, three_parts
from tests.recording.test_states import EVENTS


def record_in_parts(folder: Path, events: list[RunEvent], ends: set[int]) -> Path:
    """Record events; after those numbers another file is begun."""
    writer = BagWriter(folder / "session.mcap", rotation=RotateConfig(size=1))
    writer.metadata(METADATA_NAME, {"name": "x", "started_ns": "500"})
    channels = {topic: writer.register(topic) for topic in topics.ALL_TOPICS}
    for number, event in enumerate(events):
        for topic, data, key in convert(event):
            if topic not in channels:
                channels[topic] = writer.register(topic)
            stamp = event.stamp_ns
            channel = channels[topic]
            writer.write(channel, data, log_time=1000 + number, publish_time=stamp, key=key)
        if number in ends:
            writer.flush()
    writer.close()
    return folder


@settings(max_examples=50)
@given(st.lists(EVENTS | OTHERS, max_size=20), st.sets(st.integers(0, 20), max_size=4))
def test_events_are_the_same_however_many_files(events: list[RunEvent], ends: set[int]) -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = record_in_parts(Path(name), events, ends)
        session = PastSession(folder)
        happened = list(session.events())
        assert [each.event for each in happened] == events
        assert [each.log_time for each in happened] == [1000 + n for n in range(len(events))]
        assert session.started_ns == 500
        reader = session.reader
        assert (reader.damages, reader.is_complete) == ([], True)
        messages = [one for event in events for one in convert(event)]
        assert sum(reader.counts.values()) == len(messages)


def test_a_file_alone_says_how_everything_stood(tmp_path: Path) -> None:
    three_parts(tmp_path)
    session = PastSession(tmp_path / "session_2.mcap")
    events = [happened.event for happened in session.events()]
    assert len(events) == 1 + 2
    states = [each for each in events if isinstance(each, ContainerStateChanged)]
    assert [(each.container, each.state.value) for each in states] == [("/c", "running")]


def test_the_last_file_may_be_unfinished(tmp_path: Path) -> None:
    three_parts(tmp_path)
    (tmp_path / "session_2.mcap").rename(tmp_path / "session_2.mcap.active")
    with (tmp_path / "session_2.mcap.active").open("r+b") as file:
        file.truncate(file.seek(0, 2) - 700)
    reader = BagReader(tmp_path)
    assert len(list(reader.messages())) >= 2 + 2 + 2
    assert not reader.is_complete
    assert [damage.file for damage in reader.damages] == ["session_2.mcap.active"]
    assert str(reader.damages[0]).startswith("session_2.mcap.active: byte ")


def test_of_a_recovered_file_and_its_source_one_is_read(tmp_path: Path) -> None:
    three_parts(tmp_path)
    shutil.copy(tmp_path / "session_1.mcap", tmp_path / "session_1.mcap.active")
    reader = BagReader(tmp_path)
    assert sum(1 for _ in reader.messages()) == 8
    assert reader.files == ("session.mcap", "session_1.mcap", "session_2.mcap")


def test_a_missing_file_is_named_and_what_the_next_one_repeats_is_read(tmp_path: Path) -> None:
    three_parts(tmp_path)
    (tmp_path / "session_1.mcap").unlink()
    reader = BagReader(tmp_path)
    messages = list(reader.messages())
    assert len(messages) == 4 + 3
    assert [str(damage) for damage in reader.damages] == [
        "session_1.mcap: byte 0: the file is missing"
    ]


def test_files_that_were_removed_by_the_limit_are_not_missing(tmp_path: Path) -> None:
    recorded_with_limit(tmp_path, 4)
    reader = BagReader(tmp_path)
    assert 2 <= len(list(reader.messages())) <= 4
    assert (reader.damages, reader.is_complete) == ([], True)
    (tmp_path / "session_11.mcap").unlink()
    list((reader := BagReader(tmp_path)).messages())
    assert [str(damage) for damage in reader.damages] == [
        "session_11.mcap: byte 0: the file is missing"
    ]


def test_something_else_in_the_place_of_a_file_is_named(tmp_path: Path) -> None:
    three_parts(tmp_path)
    place = tmp_path / "session_1.mcap"
    place.unlink()
    place.mkdir()
    for reason in ("it is no regular file", "Too many levels of symbolic links"):
        reader = BagReader(tmp_path)
        assert len(list(reader.messages())) == 4 + 3
        assert [str(damage) for damage in reader.damages] == [f"session_1.mcap: byte 0: {reason}"]
        if place.is_dir():
            place.rmdir()
            place.symlink_to(place)


def test_a_file_that_is_none_takes_no_other_along(tmp_path: Path) -> None:
    three_parts(tmp_path)
    (tmp_path / "session_1.mcap").write_bytes(b"")
    reader = BagReader(tmp_path)
    assert len(list(reader.messages())) == 4 + 3
    assert [str(damage) for damage in reader.damages] == [
        "session_1.mcap: byte 0: it is not an MCAP file"
    ]
    for number in ("", "_2"):
        (tmp_path / f"session{number}.mcap").write_bytes(b"")
    with pytest.raises(NotARecordingError, match=r"session\.mcap: it is not an MCAP file"):
        list(BagReader(tmp_path).messages())
