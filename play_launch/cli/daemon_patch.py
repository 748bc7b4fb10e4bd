"""``play-launch daemon patch | unpatch``: change an installed ros2cli's own daemon."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from play_launch.cli.output import fail, say
from play_launch.supervisor.exit_code import ExitCode

_CHANGES = (
    "listens with a queue of 512 connections, not 5",
    "no client that is silent, slow or does not read delays others; 10 s for each",
    "answers about the graph are given again for 200 ms",
    "the network's interfaces are listed every 30 s, not at each call",
    "the machine's own addresses are remembered for 30 s",
    "web pages are refused",
    "calls are not printed",
    "the loop wakes every 200 ms and handles signals",
)
_RESTART = (
    "A daemon that runs already keeps its code: `ros2 daemon stop`; the next ros2 starts a new one"
)

_DryRun = Annotated[
    bool, typer.Option("--dry-run", help="Print what would be done, and change nothing.")
]
_Into = Annotated[
    Path | None,
    typer.Option(
        "--into",
        metavar="FOLDER",
        help="Folder of packages that the Python of ros2 reads; default: your own, or that of "
        "its virtual environment.",
    ),
]


def patch(dry_run: _DryRun = False, into: _Into = None) -> None:
    """Make the daemon of an installed ros2cli stay responsive while many nodes start.

    For systems that must keep that daemon; 'play-launch daemon start' is the better one. No file
    of ros2cli is touched: a package is written beside it, which changes the daemon when Python
    imports it. 'play-launch daemon unpatch' removes it.
    """
    # Only when it runs: help comes up faster.
    from play_launch.graph_daemon.patch import PatchError, default_folder, write  # noqa: PLC0415

    try:
        folder = into or default_folder()
        if not dry_run:
            write(folder)
    except PatchError as error:
        fail(str(error), ExitCode.USAGE)
    say("would change in ros2cli's daemon:" if dry_run else "changes in ros2cli's daemon:")
    for change in _CHANGES:
        say(f"  {change}")
    say(f"{'would be written' if dry_run else 'written'} to {folder}")
    if not dry_run:
        say(_RESTART)


def unpatch(dry_run: _DryRun = False, into: _Into = None) -> None:
    """Remove what 'play-launch daemon patch' has written."""
    from play_launch.graph_daemon.patch import (  # noqa: PLC0415
        PatchError,
        default_folder,
        is_written,
        remove,
    )

    try:
        folder = into or default_folder()
        present = is_written(folder) if dry_run else remove(folder)
    except PatchError as error:
        fail(str(error), ExitCode.USAGE)
    if not present:
        say(f"no patch in {folder}; nothing to do")
        return
    say(f"{'would remove' if dry_run else 'removed'} the patch from {folder}")
    if not dry_run:
        say(_RESTART)
