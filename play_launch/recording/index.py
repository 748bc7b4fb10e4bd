"""`metadata.yaml`: a folder with it is one bag to rosbag2, of however many files."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Any, Final, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

INDEX_NAME: Final = "metadata.yaml"
NEW_SUFFIX: Final = ".new"
"""Appended to its name until it is whole."""
_VERSION: Final = 8
"""With the quality of service as text; 9 has a list there, which older versions do not read."""


class IndexedTopic(NamedTuple):
    """A topic, as it stands in the index."""

    name: str
    type_name: str
    offered_qos_profiles: str


class IndexedFile(NamedTuple):
    """A file; times are nanoseconds since the epoch."""

    name: str
    begin: int
    end: int
    counts: Mapping[IndexedTopic, int]
    """Messages."""


def write_index(folder: Path, files: Sequence[IndexedFile], ros_distro: str) -> None:
    """Put the index of these files into their folder; may raise ``OSError``.

    ``ros_distro`` is the one that they were recorded with; empty: not known. A reader finds the
    index of before or the new one, whole.
    """
    import yaml  # noqa: PLC0415 - when the first file is complete

    text = yaml.safe_dump(
        {"rosbag2_bagfile_information": index(files, ros_distro)}, sort_keys=False
    )
    new = folder / (INDEX_NAME + NEW_SUFFIX)
    new.write_text(text, encoding="utf-8")
    new.rename(folder / INDEX_NAME)


def index(files: Sequence[IndexedFile], ros_distro: str) -> dict[str, Any]:
    """What rosbag2 wants to know of a bag (rosbag2_storage, `BagMetadata`)."""
    filled = [file for file in files if any(file.counts.values())]
    begin = min((file.begin for file in filled), default=0)
    end = max((file.end for file in filled), default=0)
    counts: Counter[IndexedTopic] = Counter()
    for file in files:
        counts.update(file.counts)
    return {
        "version": _VERSION,
        "storage_identifier": "mcap",
        "duration": {"nanoseconds": end - begin},
        "starting_time": {"nanoseconds_since_epoch": begin},
        "message_count": counts.total(),
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    "name": topic.name,
                    "type": topic.type_name,
                    "serialization_format": "cdr",
                    "offered_qos_profiles": topic.offered_qos_profiles,
                    "type_description_hash": "",
                },
                "message_count": count,
            }
            for topic, count in sorted(counts.items())
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [file.name for file in files],
        "files": [
            {
                "path": file.name,
                "starting_time": {"nanoseconds_since_epoch": file.begin},
                "duration": {"nanoseconds": file.end - file.begin},
                "message_count": sum(file.counts.values()),
            }
            for file in files
        ],
        "custom_data": None,
        "ros_distro": ros_distro,
    }
