"""The index of a folder, as rosbag2 reads it.

The fields and their types are those that rosbag2_storage 0.26.5 (Jazzy) converts, each by name and
without a default: `yaml.hpp` (`convert<BagMetadata>::decode` and what it calls, for version 8) and
`qos.cpp`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from play_launch.recording.folder import IndexedFile, IndexedTopic, write_index
from play_launch.recording.topics import ALL_TOPICS

TIME = {"nanoseconds_since_epoch": int}
LENGTH = {"nanoseconds": int}
FIELDS = {
    "version": int,
    "storage_identifier": str,
    "duration": LENGTH,
    "starting_time": TIME,
    "message_count": int,
    "topics_with_message_count": [
        {
            "topic_metadata": {
                "name": str,
                "type": str,
                "serialization_format": str,
                "offered_qos_profiles": str,
                "type_description_hash": str,
            },
            "message_count": int,
        }
    ],
    "compression_format": str,
    "compression_mode": str,
    "relative_file_paths": [str],
    "files": [{"path": str, "starting_time": TIME, "duration": LENGTH, "message_count": int}],
    "ros_distro": str,
}
SOME = IndexedTopic("/chatter", "std_msgs/msg/String", "")
STATES = ALL_TOPICS[1]
OURS = IndexedTopic(STATES.name, STATES.type_name, STATES.offered_qos_profiles)


def mistakes(value: Any, wanted: Any, place: str = "") -> list[str]:
    """Where a value is not as wanted; what is besides is not looked at, as rosbag2 does."""
    if isinstance(wanted, dict):
        if not isinstance(value, dict):
            return [place]
        return [
            found
            for key, each in wanted.items()
            for found in mistakes(value.get(key), each, f"{place}/{key}")
        ]
    if isinstance(wanted, list):
        if not isinstance(value, list):
            return [place]
        return [
            found
            for number, each in enumerate(value)
            for found in mistakes(each, wanted[0], f"{place}/{number}")
        ]
    return [] if type(value) is wanted and (wanted is not int or value >= 0) else [place]


@pytest.mark.parametrize(
    "files",
    [
        [],
        [IndexedFile("0.mcap", 0, 0, {})],
        [
            IndexedFile("0.mcap", 5, 9, {SOME: 3, OURS: 0}),
            IndexedFile("1.mcap", 9, 11, {SOME: 1}),
        ],
    ],
    ids=["no file", "an empty file", "two files"],
)
@pytest.mark.parametrize("distro", ["jazzy", ""])
def test_rosbag2_finds_each_field_it_reads(
    tmp_path: Path, files: list[IndexedFile], distro: str
) -> None:
    write_index(tmp_path, files, distro)
    text = (tmp_path / "metadata.yaml").read_text(encoding="utf-8")
    information = yaml.safe_load(text)["rosbag2_bagfile_information"]
    assert information["version"] == 8, "another version has other fields"
    assert mistakes(information, FIELDS) == []
    # No mapping: rosbag2 goes through its entries, of which a null has none.
    assert information["custom_data"] is None
    assert information["message_count"] == sum(sum(each.counts.values()) for each in files)
