from __future__ import annotations

import json
import os
from datetime import UTC, datetime
from pathlib import Path

import pytest
from mcap.records import Attachment, Header, Metadata

from play_launch.recording.errors import RecordingError
from play_launch.recording.session import (
    SessionDescription,
    announce,
    create_session_folder,
    default_log_folder,
    open_session,
)
from play_launch.supervisor.events import LogRecord
from tests.recording.reading import messages, records


def description(*parameter_files: tuple[str, bytes]) -> SessionDescription:
    return SessionDescription(
        name="demo",
        config_name="my.yml",
        config_text=b"version: 1 # as given\n",
        resolved_config='{"name": "demo"}',
        argv=["play-launch", "replay", "my.yml"],
        environ={"ROS_DOMAIN_ID": "7", "SOME_TOKEN": "hidden", "RMW_IMPLEMENTATION": "rmw_x"},
        parameter_files=parameter_files,
    )


def test_the_head_of_a_recording_tells_everything_about_the_run(tmp_path: Path) -> None:
    session = open_session(
        description(("p.yaml", b"a: 1\n"), ("p.yaml", b"a: 2\n")), log_folder=tmp_path / "logs"
    )
    # Complete before anything has happened: a crash in the first moment keeps it.
    found = list(records(session.folder / "session.mcap.active"))
    assert isinstance(found[0], Header)
    attachments = {record.name: record for record in found if isinstance(record, Attachment)}
    assert [*attachments] == [
        "config.yml",
        "parameters/0-p.yaml",
        "parameters/1-p.yaml",
        "resolved_config.json",
        "environment.json",
        "host.json",
    ]
    assert attachments["config.yml"].data == b"version: 1 # as given\n"
    assert attachments["parameters/0-p.yaml"].data == b"a: 1\n"
    assert attachments["parameters/1-p.yaml"].data == b"a: 2\n"
    assert json.loads(attachments["environment.json"].data)["ROS_DOMAIN_ID"] == "7"
    assert b"hidden" not in attachments["environment.json"].data
    assert json.loads(attachments["host.json"].data)["cpus"] > 0
    (metadata,) = [record for record in found if isinstance(record, Metadata)]
    assert metadata.name == "play_launch.session"
    values = metadata.metadata
    assert values["schema_version"] == "1"
    assert values["id"] == session.id
    assert json.loads(values["argv"]) == ["play-launch", "replay", "my.yml"]
    assert values["rmw_implementation"] == "rmw_x"
    assert values["kernel"] == os.uname().release
    assert "python" in json.loads(values["versions"])
    assert set(values) >= {"boot_id", "started_ns", "name", "ros_domain_id"}

    session.recorder.publish(LogRecord(stamp_ns=1, level=20, name="n", message="m"))
    summary = session.recorder.close()
    assert summary.path == session.folder / "session.mcap"
    assert (tmp_path / "logs" / "latest" / "session.mcap").samefile(summary.path)
    assert [read.message.msg for read in messages(summary.path)] == ["m"]


NOW = datetime(2026, 11, 21, 6, 36, 25, tzinfo=UTC).timetuple()


def test_the_default_log_folder_follows_the_environment() -> None:
    both = {"PLAY_LAUNCH_LOG_DIR": "/x/own", "ROS_LOG_DIR": "/x/ros"}
    assert default_log_folder(both) == Path("/x/own")
    both = {"ROS_HOME": "/x/home", "ROS_LOG_DIR": "/x/ros"}
    assert default_log_folder(both) == Path("/x/ros/play_launch")
    assert default_log_folder({"ROS_HOME": "/x/home"}) == Path("/x/home/play_launch")
    empty = default_log_folder({"PLAY_LAUNCH_LOG_DIR": "", "ROS_LOG_DIR": ""})
    assert empty == Path.home() / ".ros" / "play_launch"


def test_a_session_has_a_folder_and_latest_points_to_it(tmp_path: Path) -> None:
    root = tmp_path / "not" / "there"
    first = create_session_folder(root, "demo", NOW)
    announce(first)
    assert first == root / "2026-11-21-06-36-25-demo"
    assert (root / "latest").readlink() == Path(first.name)

    second = create_session_folder(root, "demo", NOW)
    third = create_session_folder(root, "demo", NOW)
    announce(second)
    announce(third)
    assert [second.name, third.name] == [f"{first.name}-2", f"{first.name}-3"]
    assert (root / "latest").resolve() == third
    hidden = [entry for entry in root.iterdir() if entry.name.startswith(".")]
    assert hidden == [root / ".order"]
    assert hidden[0].read_text().split() == [each.name for each in (first, second, third)]


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("../../etc/x y", "etc_x_y"),
        ("", "session"),
        ("...", "session"),
        ("grün", "gr_n"),
        ("x" * 500, "x" * 100),
    ],
)
def test_any_name_makes_a_folder_below_the_log_folder(
    tmp_path: Path, name: str, expected: str
) -> None:
    folder = create_session_folder(tmp_path, name, NOW)
    assert folder.parent == tmp_path
    assert folder.name == f"2026-11-21-06-36-25-{expected}"


def test_a_log_folder_that_is_a_file_is_explained(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(RecordingError, match="--log-dir") as caught:
        create_session_folder(tmp_path / "file", "demo", NOW)
    assert str(tmp_path / "file") in str(caught.value)


def test_a_session_does_not_need_latest(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    (tmp_path / "latest" / "notes").mkdir(parents=True)
    folder = create_session_folder(tmp_path, "demo", NOW)
    announce(folder)
    assert folder.is_dir()
    assert "latest" in caplog.text
    assert sorted(entry.name for entry in tmp_path.iterdir()) == [
        ".order",
        folder.name,
        "latest",
    ]
