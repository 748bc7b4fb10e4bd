"""The configuration of a session, and what differed from that of the session before."""

from __future__ import annotations

import difflib
from typing import TYPE_CHECKING, Final

from msgspec import Struct

from play_launch.postmortem.bag_reader import BagReader, NotARecordingError
from play_launch.postmortem.report.page import shown
from play_launch.recording.folder import age_in, part_file
from play_launch.recording.session import LATEST

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from mcap.records import Attachment

_MOST_LINES: Final = 20_000
"""Of a configuration; larger ones are not compared."""
_MOST_TEXT: Final = 400_000
"""Characters of a file that a page shows."""


class File(Struct, frozen=True):
    """A file that the recording holds."""

    name: str
    text: str


class Configuration(Struct, frozen=True):
    """What a page shows of it."""

    files: tuple[File, ...]
    """The configuration and its parameter files."""
    before: str
    """Folder of the session before; empty if none can be read."""
    difference: tuple[str, ...]
    """Lines of a unified diff from that to this; empty: no difference."""


def configuration(path: Path, attachments: Mapping[str, Attachment]) -> Configuration:
    """Read the configuration, and compare it with that of the session before in the same folder."""
    files = _files(attachments)
    before = _before(path)
    if before is None:
        return Configuration(_cut(files), "", ())
    folder, old = before
    return Configuration(_cut(files), shown(folder), _difference(folder, old, files))


def _files(attachments: Mapping[str, Attachment]) -> tuple[File, ...]:
    return tuple(
        File(shown(name), shown(each.data.decode("utf-8", "replace")))
        for name, each in sorted(attachments.items())
        if name.startswith(("config.", "parameters/"))
    )


def _cut(files: tuple[File, ...]) -> tuple[File, ...]:
    return tuple(
        each
        if len(each.text) <= _MOST_TEXT
        else File(each.name, f"{each.text[:_MOST_TEXT]}\n[cut: {len(each.text):,} characters]")
        for each in files
    )


def _difference(folder: str, old: tuple[File, ...], new: tuple[File, ...]) -> tuple[str, ...]:
    lines: list[str] = []
    texts = [{each.name: each.text.splitlines() for each in files} for files in (old, new)]
    for name in sorted(texts[0].keys() | texts[1].keys()):
        one, two = (each.get(name, []) for each in texts)
        if len(one) + len(two) > _MOST_LINES and one != two:
            lines.append(f"{name} differs, and is too large to be compared line by line")
            continue
        lines += difflib.unified_diff(one, two, f"{folder}/{name}", name, lineterm="", n=3)
    return tuple(lines)


def _before(path: Path) -> tuple[str, tuple[File, ...]] | None:
    """Find the session before in the same log folder."""
    path = path.resolve()  # `latest` is a link
    folder = path if path.is_dir() else path.parent
    if folder is not path and part_file(path) is None:
        return None  # a file that was moved
    try:
        others = [each.name for each in folder.parent.iterdir() if each.name != LATEST]
    except OSError:
        return None
    age = age_in(folder.parent)
    earlier = (each for each in others if age(each) < age(folder.name))
    for other in sorted(earlier, key=age, reverse=True):
        reader = BagReader(folder.parent / other)
        try:
            # Attachments stand before the first message.
            next(reader.messages(), None)
        except NotARecordingError:
            continue
        if files := _files(reader.attachments):
            return other, files
    return None
