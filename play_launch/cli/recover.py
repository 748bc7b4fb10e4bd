"""A whole recording of a damaged or unfinished one."""

from __future__ import annotations

from typing import TYPE_CHECKING

from play_launch.cli.info import DAMAGED, report_damage
from play_launch.cli.output import fail, say
from play_launch.cli.target import complain
from play_launch.postmortem.recover import RecoverError, default_output, recover
from play_launch.supervisor.exit_code import ExitCode

if TYPE_CHECKING:
    from pathlib import Path


def write_anew(file: Path, output: Path | None) -> int:
    """Recover a recording; return the exit code."""
    try:
        if file.is_dir():
            return _complete_folder(file, output)
        recovered = recover(file, output or default_output(file))
    except RecoverError as error:
        fail(str(error), ExitCode.NODE_FAILED)
    say(f"{recovered.path}: {recovered.messages:,} messages", beside=recovered.path)
    if not recovered.reader.damages:
        return 0
    report_damage(recovered.reader)
    return DAMAGED


def _complete_folder(folder: Path, output: Path | None) -> int:
    from play_launch.postmortem.archive.folders import is_being_written  # noqa: PLC0415 - rarely needed
    from play_launch.postmortem.archive.leftovers import complete_files  # noqa: PLC0415
    from play_launch.recording.folder import active_parts, parts_of  # noqa: PLC0415

    if output is not None:
        raise RecoverError(f"{folder} is a folder, recovered in place; leave --output out")
    parts = parts_of(folder)
    if not parts:
        raise RecoverError(f"{folder}: no session.mcap is in this folder")
    for part in (*parts, *active_parts(folder)):
        if not part.path.is_file():
            raise RecoverError(f"{part.path}: it is no regular file")
    for part in active_parts(folder):
        if is_being_written(part.path):
            raise RecoverError(f"{part.path} is being written by a running session; stop that")
    completed = complete_files(folder)
    if not completed:
        say(f"{folder}: every file is complete")
    for one in completed:
        say(f"{one.path}: {one.messages:,} messages")
        for damage in one.damages:
            complain(f"warning: {one.path}: {damage}")
    return DAMAGED if any(one.damages for one in completed) else 0
