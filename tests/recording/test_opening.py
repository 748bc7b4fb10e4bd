from __future__ import annotations

import json
import os
from typing import TYPE_CHECKING

import pytest
from mcap.records import Attachment, Header, Metadata

from play_launch.recording.errors import RecordingError
from play_launch.recording.session import SessionDescription, open_session
from play_launch.supervisor.events import LogRecord
from tests.recording.reading import messages, records

if TYPE_CHECKING:
    from pathlib import Path


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
    found = list(records(session.folder.bag.with_name("session.mcap.active")))
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
    assert summary.path == session.folder.bag
    assert (tmp_path / "logs" / "latest" / "session.mcap").samefile(summary.path)
    assert [read.message.msg for read in messages(summary.path)] == ["m"]


def test_a_log_folder_that_cannot_be_used_is_explained(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(RecordingError, match="--log-dir"):
        open_session(description(), log_folder=tmp_path / "file")
