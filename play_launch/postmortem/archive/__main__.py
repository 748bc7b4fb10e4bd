"""``python -m play_launch.postmortem.archive``: complete or remove earlier sessions, once."""

from __future__ import annotations

import argparse
import os
import sys
import time
from pathlib import Path
from typing import Final

from play_launch.config.model import KeepConfig
from play_launch.postmortem.archive.folders import list_sessions
from play_launch.postmortem.archive.leftovers import Completed, complete_session
from play_launch.postmortem.archive.removal import finish_removals, remove_session
from play_launch.postmortem.archive.retention import sessions_to_remove
from play_launch.postmortem.recover import RecoverError

_LONGEST: Final = 600.0
"""Seconds after which no further file is begun; the next start goes on."""
_UNITS: Final = 1_000_000


def main() -> int:
    """Remove what is too much, complete what was cut off; print a line for each of the two."""
    parser = argparse.ArgumentParser(prog="python -m play_launch.postmortem.archive")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--keep-sessions", type=int)
    parser.add_argument("--keep-size", type=int)
    arguments = parser.parse_args()
    _be_humble()
    keep = KeepConfig(arguments.keep_sessions, arguments.keep_size)
    errors: list[str] = []
    remove(arguments.folder, keep, errors)
    complete(arguments.folder, errors)
    for error in errors:
        print(f"warning: {error}")  # noqa: T201 - read by the supervisor
    return 1 if errors else 0


def remove(log_folder: Path, keep: KeepConfig, errors: list[str]) -> None:
    """Keep to the limits; what cannot be removed keeps nothing else."""
    removed = []
    try:
        finish_removals(log_folder)
    except OSError as error:
        errors.append(f"a removal in {log_folder} cannot be finished: {error.strerror}")
    for one in sessions_to_remove(list_sessions(log_folder), keep):
        try:
            if remove_session(log_folder / one.name):
                removed.append(one)
        except OSError as error:
            errors.append(f"{log_folder / one.name} cannot be removed: {error.strerror}")
    if removed:
        size = sum(one.size for one in removed) / _UNITS
        print(  # noqa: T201 - as above
            f"info: removed {_sessions(len(removed))} ({size:,.1f} MB) from {log_folder}, "
            f"the latest of them {removed[-1].name}"
        )


def complete(log_folder: Path, errors: list[str]) -> None:
    """Complete the recordings that were cut off."""
    deadline = time.monotonic() + _LONGEST
    completed: list[Completed] = []
    for entry in list_sessions(log_folder):
        if entry.active and time.monotonic() < deadline:
            try:
                completed += complete_session(log_folder / entry.name)
            except RecoverError as error:
                errors.append(str(error))
    if not completed:
        return
    messages = sum(one.messages for one in completed)
    sessions = {one.path.parent.name for one in completed}
    gaps = [one.path.name for one in completed if one.has_gaps]
    line = (
        f"warning: recovered the recording of {_sessions(len(sessions))} that did not end in order "
        f"({messages:,} messages): {', '.join(sorted(sessions))}"
    )
    if gaps:
        line += f"; parts are damaged in {len(gaps)} files, which are kept as .damaged"
    print(line)  # noqa: T201 - as above


def _sessions(count: int) -> str:
    return f"{count} session" if count == 1 else f"{count} sessions"


def _be_humble() -> None:
    """Take the lowest priority for processor and disk."""
    import psutil  # noqa: PLC0415 - takes a while

    os.nice(19)
    try:
        psutil.Process().ionice(psutil.IOPRIO_CLASS_IDLE)
    except OSError:
        return


if __name__ == "__main__":
    sys.exit(main())
