"""The recording of a session: its folder, its file, and what stands at the head of that.

The folder is ``<log folder>/<time>-<name>/``, with ``latest`` pointing to it.
"""

from __future__ import annotations

import json
import logging
import math
import os
import re
import shutil
import sys
import time
import uuid
from contextlib import suppress
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Final

from msgspec import Struct

from play_launch.config.model import RecordConfig
from play_launch.container.cdr.structure import text_bytes
from play_launch.recording import environment
from play_launch.recording.bag import BagWriter
from play_launch.recording.clock import SessionClock
from play_launch.recording.errors import RecordingError, reason
from play_launch.recording.folder import BAG_NAME, note_start
from play_launch.recording.recorder import Recorder
from play_launch.recording.resolved_form import redacted_arguments
from play_launch.recording.topics import METADATA_NAME, RESOLVED

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from play_launch.recording.limits import RecorderLimits


LATEST: Final = "latest"

_log = logging.getLogger(__name__)
_UNSAFE: Final = re.compile(r"[^A-Za-z0-9._-]+")
_LONGEST_NAME: Final = 100
SCHEMA_VERSION: Final = 1
"""Version of the layout of a recording: topics, attachments and metadata."""
ROS_DISTRO: Final = "ros_distro"
"""A name in it; empty where the environment does not say."""
INCLUDED: Final = "includes/"
PARAMETERS: Final = "parameters/"
"""What the names of attached files begin with."""


class SessionDescription(Struct, frozen=True, kw_only=True):
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
    included_files: Sequence[tuple[str, bytes]] = ()
    """File names and contents, in the order in which they were read."""
    parameter_files: Sequence[tuple[str, bytes]] = ()
    """File names and contents, in the order in which the configuration names them."""


class Session(Struct, frozen=True):
    """An open session."""

    id: str
    folder: Path
    recorder: Recorder


def open_session(
    description: SessionDescription,
    *,
    log_folder: Path | None = None,
    record: RecordConfig | None = None,
    limits: RecorderLimits | None = None,
    clock: SessionClock | None = None,
) -> Session:
    """Start recording a session and return it.

    ``log_folder`` is where the session's folder is made, by default
    :func:`default_log_folder`; ``record`` has the settings. Raises
    :class:`RecordingError` when it cannot even begin.
    """
    record, clock = record or RecordConfig(), clock or SessionClock()
    root = log_folder or default_log_folder(description.environ)
    folder = create_session_folder(root.expanduser(), description.name, time.localtime())
    session_id = str(uuid.uuid4())
    try:
        writer = BagWriter(
            folder / BAG_NAME,
            rotation=record.rotate,
            limit=math.inf if record.keep.size is None else record.keep.size,
            sync=record.sync,
            has_index=True,
            ros_distro=_ros_distro(description),
            now=clock.now,
        )
        try:
            write_head(writer, description, session_id, now=clock.now())
            recorder = Recorder(writer, limits=limits, clock=clock)
        except RecordingError:
            writer.abandon()
            raise
    except RecordingError:
        # A service that is started again and again would leave as many folders.
        shutil.rmtree(folder, ignore_errors=True)
        raise
    announce(folder)
    return Session(session_id, folder, recorder)


def write_head(
    writer: BagWriter, description: SessionDescription, session_id: str, *, now: int
) -> None:
    """Write attachments and metadata, before any message, so that a crash keeps them."""
    suffix = Path(description.config_name).suffix or ".yaml"
    writer.attach(f"config{suffix}", "application/yaml", description.config_text, time=now)
    kinds = {
        INCLUDED: description.included_files,
        PARAMETERS: description.parameter_files,
    }
    for kind, files in kinds.items():
        for number, (name, text) in enumerate(files):
            # Numbered: files of the same name may come from different folders.
            writer.attach(f"{kind}{number}-{name}", "application/yaml", text, time=now)
    writer.attach(
        RESOLVED,
        "application/json",
        text_bytes(description.resolved_config),
        time=now,
    )
    environ = environment.redacted_environment(description.environ)
    writer.attach("environment.json", "application/json", _json(environ), time=now)
    host = environment.host_facts()
    writer.attach("host.json", "application/json", _json(host), time=now)
    versions = environment.versions()
    writer.metadata(
        METADATA_NAME,
        {
            "schema_version": str(SCHEMA_VERSION),
            "id": session_id,
            "name": description.name,
            "started_ns": str(now),
            "clock": "boottime",
            "argv": json.dumps(redacted_arguments(description.argv), ensure_ascii=False),
            "versions": json.dumps(versions, ensure_ascii=False),
            "play_launch_version": versions.get("play-launch-py", ""),
            "rmw_implementation": description.environ.get("RMW_IMPLEMENTATION", ""),
            ROS_DISTRO: _ros_distro(description),
            "ros_domain_id": description.environ.get("ROS_DOMAIN_ID", ""),
            "kernel": str(host["kernel"]),
            "boot_id": str(host["boot_id"]),
            "python_executable": sys.executable,
        },
    )
    writer.flush()


def _ros_distro(description: SessionDescription) -> str:
    return description.environ.get("ROS_DISTRO", "")


def _json(values: Mapping[str, object]) -> bytes:
    # What is not Unicode becomes an escape, which JSON reads back as it was.
    return text_bytes(json.dumps(values, indent=2, ensure_ascii=False))


def announce(folder: Path) -> None:
    """Put the folder of a session at the end of their order, and point ``latest`` to it.

    ``latest`` is relative, so that the log folder can be moved.
    """
    name, latest = folder.name, folder.with_name(LATEST)
    try:
        note_start(folder)
    except OSError as error:
        _log.warning("cannot note in %s that %s began: %s", latest.parent, name, reason(error))
    # Renaming replaces in one step: a reader finds the old session or the new one, never nothing.
    temporary = latest.with_name(f".{LATEST}-{name}")
    try:
        temporary.symlink_to(name)
        temporary.replace(latest)
    except OSError as error:
        # A file system without symbolic links, or another file of that name: the session
        # itself does not depend on it.
        _log.warning("cannot point %s to %s: %s", latest, name, reason(error))
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def default_log_folder(environ: Mapping[str, str] = os.environ) -> Path:
    """Where sessions go by default.

    ``$PLAY_LAUNCH_LOG_DIR``, else ``play_launch`` in ``$ROS_LOG_DIR``, ``$ROS_HOME`` or ``~/.ros``.
    """
    if own := environ.get("PLAY_LAUNCH_LOG_DIR"):
        return Path(own).expanduser()
    ros = environ.get("ROS_LOG_DIR") or environ.get("ROS_HOME") or "~/.ros"
    return Path(ros).expanduser() / "play_launch"


def create_session_folder(log_folder: Path, name: str, now: time.struct_time) -> Path:
    """Make a new folder for the session.

    A second session of the same name in the same second gets ``-2`` appended, and so on. Raises
    :class:`RecordingError`.
    """
    stem = f"{time.strftime('%Y-%m-%d-%H-%M-%S', now)}-{_file_name(name)}"
    try:
        log_folder.mkdir(parents=True, exist_ok=True)
        for number in count(1):
            folder = log_folder / (stem if number == 1 else f"{stem}-{number}")
            with suppress(FileExistsError):
                folder.mkdir()
                break
    except OSError as error:
        raise RecordingError(
            f"cannot make the session folder {log_folder / stem}: {reason(error)}; "
            "choose another place with --log-dir DIR or PLAY_LAUNCH_LOG_DIR"
        ) from error
    return folder


def _file_name(name: str) -> str:
    return _UNSAFE.sub("_", name).strip("._")[:_LONGEST_NAME] or "session"
