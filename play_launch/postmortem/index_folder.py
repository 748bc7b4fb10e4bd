"""The index of a session's folder, from the files in it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mcap.exceptions import McapError
from mcap.reader import make_reader

from play_launch.postmortem.bag_reader import NotARecordingError
from play_launch.recording.folder import IndexedFile, IndexedTopic, parts_of, write_index
from play_launch.recording.session import METADATA_NAME, ROS_DISTRO

if TYPE_CHECKING:
    from pathlib import Path


def index_folder(folder: Path) -> None:
    """Write ``metadata.yaml`` for the files of a session that are complete.

    Raises:
        OSError: When something cannot be read or written.
        NotARecordingError: When a file has no summary.
    """
    parts = [part.path for part in parts_of(folder) if not part.is_active]
    files, distros = [], []
    for path in parts:
        file, distro = _indexed(path)
        files.append(file)
        distros.append(distro)
    write_index(folder, files, next(filter(None, distros), ""))


def _indexed(path: Path) -> tuple[IndexedFile, str]:
    """Give what the index says of a file, and the ROS distribution that it was recorded with."""
    try:
        with path.open("rb") as file:
            reader = make_reader(file)
            summary = reader.get_summary()
            about = {one.name: one.metadata for one in reader.iter_metadata()}
    except (McapError, ValueError, EOFError) as error:
        raise NotARecordingError(f"{path}: {error}") from error
    if summary is None or summary.statistics is None:
        raise NotARecordingError(f"{path}: it has no summary")
    statistics = summary.statistics
    counts: dict[IndexedTopic, int] = {}
    for number, channel in summary.channels.items():
        schema = summary.schemas.get(channel.schema_id)
        topic = IndexedTopic(
            channel.topic,
            schema.name if schema else "",
            channel.metadata.get("offered_qos_profiles", ""),
        )
        count = statistics.channel_message_counts.get(number, 0)
        counts[topic] = counts.get(topic, 0) + count
    begin, end = statistics.message_start_time, statistics.message_end_time
    distro = about.get(METADATA_NAME, {}).get(ROS_DISTRO, "")
    return IndexedFile(path.name, begin, end, counts), distro
