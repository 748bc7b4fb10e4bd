"""A whole recording of a damaged or unfinished one."""

from __future__ import annotations

from typing import TYPE_CHECKING

from play_launch.cli.failure import fail
from play_launch.cli.show.terminal import say
from play_launch.cli.sum_up import DAMAGED, report_damage
from play_launch.core.exit_code import ExitCode
from play_launch.history.recover import RecoverError, default_output, recover

if TYPE_CHECKING:
    from pathlib import Path


def write_anew(file: Path, output: Path | None) -> int:
    """Recover a recording; return the exit code."""
    try:
        recovered = recover(file, output or default_output(file))
    except RecoverError as error:
        fail(str(error), ExitCode.NODE_FAILED)
    say(f"{recovered.path}: {recovered.messages:,} messages")
    if not recovered.reader.damages:
        return 0
    report_damage(recovered.reader)
    return DAMAGED
