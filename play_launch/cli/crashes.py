"""What ``play-launch crashes`` does: groups the equal crashes of all sessions in a folder."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import msgspec

from play_launch import ExitCode
from play_launch.cli import options
from play_launch.cli.output import clock, counted, fail, printable, say, warn
from play_launch.postmortem.bag_reader import NotARecordingError
from play_launch.postmortem.comparison import CrashGroup, CrashGroups
from play_launch.postmortem.timeline import read_timeline
from play_launch.recording.folder import ACTIVE_SUFFIX, part_file

if TYPE_CHECKING:
    from collections.abc import Iterator


def crashes(
    folder: Annotated[Path, options.argument("DIR", "A log folder with sessions, or one file.")],
    as_json: options.Json = False,
) -> int:
    """Group the crashes of many sessions: crashes with equal signatures are one group.

    A signature is the signal or exception and the innermost functions of your own code, without
    addresses. Exits with 2 if there is no recording, with 5 if one could not be read completely.
    """
    if not folder.exists():
        fail(f"{folder}: no such folder")
    groups = CrashGroups()
    count = 0
    unread: list[str] = []
    for path in recordings(folder, unread):
        try:
            timeline = read_timeline(path, only_failures=True)
        except NotARecordingError as error:
            unread.append(str(error))
            continue
        groups.add(timeline)
        unread += [f"{path}: {damage}" for damage in timeline.session.reader.damages]
        count += 1
    if count == 0 and not unread:
        fail(f"{folder}: there is no recording (*.mcap) in it")
    found = groups.sorted()
    if as_json:
        listed = [
            {"id": each.signature.id, "title": str(each.signature)} | msgspec.to_builtins(each)
            for each in found
        ]
        values = {"sessions": count, "unread": unread, "crashes": listed}
        say(msgspec.json.encode(values).decode())
    else:
        for each in found:
            for line in _lines(each):
                say(printable(line))
        say(f"{counted(len(found), 'signature')} in {counted(count, 'session')}")
    for text in unread:
        warn(text)
    return ExitCode.DAMAGED if unread else 0


def recordings(folder: Path, unread: list[str]) -> list[Path]:
    """List the recordings below a folder, or the file itself; links are not followed.

    The files of one session are one recording, which is their folder. Folders that cannot be read
    are added to ``unread``.
    """
    if folder.is_file():
        return [folder]
    found = set()
    walk = os.walk(
        folder, onerror=lambda error: unread.append(f"{error.filename}: {error.strerror}")
    )
    for path in (Path(place, name) for place, _, names in walk for name in names):
        is_recording = path.name.removesuffix(ACTIVE_SUFFIX).endswith(".mcap")
        if is_recording and not path.is_symlink():
            found.add(path.parent if part_file(path) else path)
    return sorted(found)


def _lines(group: CrashGroup) -> Iterator[str]:
    where = counted(group.sessions, "session")
    yield f"{group.signature.id}  {group.signature}"
    yield f"  {counted(group.count, 'time')} in {where}, {_when(group)}"
    yield f"  {counted(len(group.nodes), 'member')}: {', '.join(group.nodes)}"
    yield from (f"  called by {frame}" for frame in group.signature.frames[1:])
    if group.builds:
        yield f"  builds: {', '.join(group.builds)}"
    if group.versions:
        yield f"  play-launch {', '.join(group.versions)}"
    yield f"  latest: {group.cause}"
    yield f"  play-launch explain {group.example}"
    yield ""


def _when(group: CrashGroup) -> str:
    first, last = (clock(ns, "%Y-%m-%d %H:%M:%S") for ns in (group.first_ns, group.last_ns))
    return f"at {first}" if group.count == 1 else f"first at {first}, last at {last}"
