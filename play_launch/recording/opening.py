"""Opens the recording of a session: folder, file, attachments, then the recorder itself."""

from __future__ import annotations

import json
import sys
import time
import uuid
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Final

from play_launch.recording import facts
from play_launch.recording.cdr import text_bytes
from play_launch.recording.errors import RecordingError
from play_launch.recording.mcap_writer import McapBagWriter
from play_launch.recording.recorder import Recorder, RecorderLimits
from play_launch.recording.session import SessionFolder, create_session_folder, default_log_folder

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from play_launch.recording.writer import BagWriter

SCHEMA_VERSION: Final = 1
"""Version of the layout of a recording: topics, attachments and metadata."""
METADATA_NAME: Final = "play_launch.session"


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionDescription:
    """What a session is about; it becomes the head of the recording."""

    name: str
    config_name: str
    """File name of the configuration as given."""
    config_text: bytes
    """The configuration as given, unchanged."""
    resolved_config: str
    """The configuration after defaults and substitutions, as JSON."""
    argv: Sequence[str]
    environ: Mapping[str, str]
    """The supervisor's environment; it is redacted before it is written."""
    parameter_files: Sequence[tuple[str, bytes]] = ()
    """File names and contents, in the order in which the configuration names them."""


@dataclass(frozen=True, slots=True)
class Session:
    """An open session."""

    id: str
    folder: SessionFolder
    recorder: Recorder


def open_session(
    description: SessionDescription,
    *,
    on_failure: Callable[[str], None],
    log_folder: Path | None = None,
    limits: RecorderLimits | None = None,
) -> Session:
    """Start recording a session and return it.

    ``log_folder`` is where the session's folder is made, by default
    :func:`~play_launch.recording.session.default_log_folder`. ``on_failure`` is called once, from
    the recorder's thread, when the recording has to stop early. Raises :class:`RecordingError`
    when it cannot even begin.
    """
    root = log_folder or default_log_folder(description.environ)
    now = datetime.now().astimezone()
    folder = create_session_folder(root.expanduser(), description.name, now)
    session_id = str(uuid.uuid4())
    writer = McapBagWriter(folder.bag)
    try:
        write_head(writer, description, session_id)
        recorder = Recorder(writer, on_failure=on_failure, limits=limits)
    except RecordingError:
        writer.abandon()
        raise
    return Session(session_id, folder, recorder)


def write_head(writer: BagWriter, description: SessionDescription, session_id: str) -> None:
    """Write attachments and metadata, before any message, so that a crash keeps them."""
    now = time.time_ns()
    suffix = Path(description.config_name).suffix or ".yaml"
    writer.attach(f"config{suffix}", "application/yaml", description.config_text, time=now)
    for number, (name, text) in enumerate(description.parameter_files):
        # Numbered: files of the same name may come from different folders.
        writer.attach(f"parameters/{number}-{name}", "application/yaml", text, time=now)
    writer.attach(
        "resolved_config.json",
        "application/json",
        text_bytes(description.resolved_config),
        time=now,
    )
    environment = facts.redacted_environment(description.environ)
    writer.attach("environment.json", "application/json", _json(environment), time=now)
    host = facts.host_facts()
    writer.attach("host.json", "application/json", _json(host), time=now)
    versions = facts.versions()
    writer.metadata(
        METADATA_NAME,
        {
            "schema_version": str(SCHEMA_VERSION),
            "id": session_id,
            "name": description.name,
            "started_ns": str(now),
            "argv": json.dumps(list(description.argv), ensure_ascii=False),
            "versions": json.dumps(versions, ensure_ascii=False),
            "play_launch_version": versions.get("play-launch-py", ""),
            "rmw_implementation": description.environ.get("RMW_IMPLEMENTATION", ""),
            "ros_distro": description.environ.get("ROS_DISTRO", ""),
            "ros_domain_id": description.environ.get("ROS_DOMAIN_ID", ""),
            "kernel": str(host["kernel"]),
            "boot_id": str(host["boot_id"]),
            "python_executable": sys.executable,
        },
    )


def _json(values: Mapping[str, object]) -> bytes:
    # What is not Unicode becomes an escape, which JSON reads back as it was.
    return text_bytes(json.dumps(values, indent=2, ensure_ascii=False))
