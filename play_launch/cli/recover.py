"""A whole recording of a damaged or unfinished one."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Annotated

from play_launch import ExitCode
from play_launch.cli import options
from play_launch.cli.info import report_damage
from play_launch.cli.output import is_passed_on, say, warn, whole_file
from play_launch.postmortem.recover import RecoverError, default_output
from play_launch.postmortem.recover import recover as recover_file


def recover(
    file: Annotated[
        Path,
        options.argument(
            "FILE", "A session.mcap.active, a damaged .mcap, or the folder of a session."
        ),
    ],
    output: Annotated[
        Path | None,
        options.output(
            "The file to write. Default: the name without .active, or x.recovered.mcap."
        ),
    ] = None,
) -> int:
    """Write everything readable of a damaged or unfinished recording to a new, indexed file.

    The file itself is not changed. In a folder, unfinished files are replaced by complete ones; a
    file that is damaged within is kept as .damaged. Exits with 0 if nothing was lost, with 5 if
    something could not be read, with 1 if nothing was written. A recording that is being written is
    refused.
    """
    if file.is_dir():
        return _complete_folder(file, output)
    target = output or default_output(file)
    if is_passed_on(target):
        with whole_file(target) as whole:
            recovered = recover_file(file, whole, replace=True)._replace(path=target)
    else:
        recovered = recover_file(file, target)
    say(f"{recovered.path}: {recovered.messages:,} messages", beside=recovered.path)
    if not recovered.reader.damages:
        return 0
    report_damage(recovered.reader)
    source = "" if shutil.which("mcap") else "; it is part of https://mcap.dev/guides/cli"
    say(f"{file}: `mcap recover` may read more of it{source}", beside=recovered.path)
    return ExitCode.DAMAGED


def _complete_folder(folder: Path, output: Path | None) -> int:
    from play_launch.postmortem.archive import complete_files, is_being_written  # noqa: PLC0415
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
            warn(f"{one.path}: {damage}")
    return ExitCode.DAMAGED if any(one.damages for one in completed) else 0
