"""The folder of a session: the names of its files, their order, and the index."""

from __future__ import annotations

import errno
import os
import re
import stat
from collections import Counter
from contextlib import suppress
from typing import IO, TYPE_CHECKING, Any, Final, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

ACTIVE_SUFFIX: Final = ".active"
"""Appended to the name of a file while it is written."""
HALF_SUFFIX: Final = ".recovering"
"""Appended to the name of a file while it is recovered."""
MAGIC: Final = b"\x89MCAP0\r\n"
"""How an MCAP file begins and ends."""
_BUFFER: Final = 1 << 17
"""Bytes that are read at once: records of a recording are short."""
BAG_NAME: Final = "session.mcap"
CONTROL_SOCKET: Final = "control.sock"
MACHINES: Final = "machines.json"
"""Where the parts of a system are recorded that runs on several machines."""
ORDER_NAME: Final = ".order"
"""In the log folder: the names of sessions in the order of their starts, one a line. The folders
are named after the time, but the clock of a robot may begin anywhere, and be set at any time."""
INDEX_NAME: Final = "metadata.yaml"
NEW_SUFFIX: Final = ".new"
"""Appended to its name until it is whole."""
_VERSION: Final = 8
"""With the quality of service as text; 9 has a list there, which older versions do not read."""
_PART: Final = re.compile(r"session(?:_([1-9][0-9]{0,8}))?\.mcap")
_OWN: Final = re.compile(
    r"session(_\d+)?(\.mcap(\.active|\.recovering|\.damaged)*|\.html|\.trace\.json|-csv|-parquet)"
    rf"|(metadata\.yaml|{re.escape(MACHINES)})(\.new)?|{re.escape(CONTROL_SOCKET)}|\.session.*\.\d+\.writing",
    re.ASCII,
)
"""What play-launch puts into it: recordings, and what is made of them; anything else pins it."""


def note_start(folder: Path) -> None:
    """Put the folder of a session at the end of the order; may raise ``OSError``."""
    with (folder.parent / ORDER_NAME).open("ab") as file:
        file.write(os.fsencode(folder.name) + b"\n")


def age_in(log_folder: Path) -> Callable[[str], tuple[int, str]]:
    """Give what sorts the sessions of a log folder by their names, the oldest first.

    Those that are not in the order of starts came from elsewhere, or before there was one.
    """
    try:
        with os.fdopen(open_regular(log_folder / ORDER_NAME), "rb") as file:
            names = file.read().splitlines()
    except OSError:
        names = []
    places = {os.fsdecode(name): place for place, name in enumerate(names)}
    return lambda name: (places.get(name, -1), name)


class PartFile(NamedTuple):
    """One file of a recording."""

    path: Path
    number: int
    """From 0 on, in the order in which they were written."""

    @property
    def is_active(self) -> bool:
        """Whether it is being written, or was never completed."""
        return self.path.name.endswith(ACTIVE_SUFFIX)


def part_path(first: Path, number: int) -> Path:
    """``session.mcap`` for 0, then ``session_1.mcap`` and so on."""
    return first if number == 0 else first.with_name(f"{first.stem}_{number}{first.suffix}")


def part_file(path: Path) -> PartFile | None:
    """Read a file's name; None for a file that is no part of a session's recording."""
    found = _PART.fullmatch(path.name.removesuffix(ACTIVE_SUFFIX))
    return None if found is None else PartFile(path, int(found[1] or 0))


def is_own(path: Path) -> bool:
    """Whether play-launch put this into the folder of a session."""
    tables = path.name.endswith(("-csv", "-parquet"))
    return bool(_OWN.fullmatch(path.name)) and not path.is_symlink() and path.is_dir() == tables


def parts_of(folder: Path) -> list[PartFile]:
    """The files of the recording in this folder, in order; may raise ``OSError``.

    Of a file that has been completed and of what it was made of, only the former. One that was
    begun and holds nothing yet is left out: its writer was killed before it wrote the head.
    """
    found: dict[int, PartFile] = {}
    for part in filter(None, map(part_file, folder.iterdir())):
        size = 1  # of one that was completed meanwhile, which `open_bag` finds
        with suppress(OSError):
            size = part.path.stat(follow_symlinks=False).st_size
        if not part.is_active:
            found[part.number] = part
        elif size > 0:
            found.setdefault(part.number, part)
    return [found[number] for number in sorted(found)]


def active_parts(folder: Path) -> list[PartFile]:
    """The files that were not completed, in order; may raise ``OSError``."""
    found = filter(None, map(part_file, folder.iterdir()))
    return sorted((part for part in found if part.is_active), key=lambda part: part.number)


def beside(recording: Path, ending: str) -> Path:
    """``session.html`` for ``.html``: beside ``session.mcap`` or its ``.active``, or in the folder.

    `is_own` has to know the ending, or a file made there pins its session.
    """
    if recording.is_dir():
        return recording / f"session{ending}"
    name = recording.name.removesuffix(ACTIVE_SUFFIX).removesuffix(".mcap")
    return recording.with_name(f"{name}{ending}")


def open_regular(path: Path, *, follow: bool = False) -> int:
    """Open a file to read it and return the descriptor; raises ``OSError``.

    Nothing else is opened: a pipe would be waited for, a device can be endless. ``follow`` allows
    a symbolic link.
    """
    flags = os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC
    descriptor = os.open(path, flags if follow else flags | os.O_NOFOLLOW)
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise OSError(errno.EINVAL, "it is no regular file", str(path))
    return descriptor


def open_bag(path: Path) -> IO[bytes]:
    """Open a file of a recording, also one that was completed since its name was read.

    Raises:
        OSError: When that cannot be done, or it is no regular file.
    """
    try:
        return os.fdopen(open_regular(path, follow=True), "rb", _BUFFER)
    except FileNotFoundError:
        if not path.name.endswith(ACTIVE_SUFFIX):
            raise
        return open_bag(path.with_name(path.name.removesuffix(ACTIVE_SUFFIX)))


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
