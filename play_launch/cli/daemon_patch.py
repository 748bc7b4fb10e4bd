"""``play-launch daemon patch | unpatch``: make an installed ros2cli's own daemon bear a storm."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn

import typer

from play_launch.cli.output import fail, say
from play_launch.supervisor.exit_code import ExitCode

if TYPE_CHECKING:
    from play_launch.graph_daemon.patch import PatchError

_CHANGES = (
    "listens with a queue of 512 connections, not 5",
    "no client that is silent, slow or does not read keeps others waiting; 10 s for each",
    "answers about the graph are given again for 200 ms",
    "the network's interfaces are looked at every 30 s, not at each call",
    "the machine's own addresses are remembered for 30 s",
    "web pages are refused",
    "calls are not printed",
    "the loop comes round every 200 ms and sees signals",
)
_RESTART = (
    "A daemon that runs already keeps its code: `ros2 daemon stop`; the next ros2 starts a new one"
)

_DryRun = Annotated[
    bool, typer.Option("--dry-run", help="Show what would be done, and change nothing.")
]
_Python = Annotated[
    Path | None,
    typer.Option(
        "--python",
        metavar="PATH",
        help="The Python that has ros2cli; without it, the one that the command ros2 starts.",
    ),
]
_Force = Annotated[
    bool, typer.Option("--force", help="Go on although the written files were edited since.")
]


def patch(
    dry_run: _DryRun = False,
    user: Annotated[
        bool, typer.Option("--user", help="For yourself alone; needs no permissions.")
    ] = False,
    python: _Python = None,
    force: _Force = False,
) -> None:
    """Make the daemon of an installed ros2cli bear a start-up storm.

    For systems that must keep that daemon; 'play-launch daemon start' is the better one. No file
    of ros2cli is touched: a package of ours is put beside it and hooks in when Python imports the
    daemon. 'play-launch daemon unpatch' takes it away.
    """
    # Only when it runs: help comes up faster.
    from play_launch.graph_daemon.patch import PatchError  # noqa: PLC0415
    from play_launch.graph_daemon.patch.install import Action, plan_patch  # noqa: PLC0415
    from play_launch.graph_daemon.patch.target import find_target  # noqa: PLC0415

    try:
        plan = plan_patch(find_target(python), for_user=user, force=force)
        target = plan.target
        say(f"ros2cli {target.version} ({plan.distribution}) in {target.folder}")
        if plan.action is Action.NOTHING:
            say(f"patched already, from {plan.place}; nothing to do")
            return
        say("would change in its daemon:" if dry_run else "changes in its daemon:")
        for change in _CHANGES:
            say(f"  {change}")
        if dry_run:
            word = "write" if plan.action is Action.WRITE else "write anew"
            say(f"would {word} in {plan.place}:")
            for name, content in plan.contents.items():
                say(f"  {name} ({len(content)} bytes)")
            say(f"would verify with {target.python}, and take all back if that fails")
            return
        plan.carry_out()
    except PatchError as error:
        _fail(error)
    say(f"written to {plan.place} and verified")
    say(_RESTART)


def unpatch(dry_run: _DryRun = False, python: _Python = None, force: _Force = False) -> None:
    """Take away what 'play-launch daemon patch' has put beside ros2cli."""
    from play_launch.graph_daemon.patch import PatchError  # noqa: PLC0415
    from play_launch.graph_daemon.patch.install import (  # noqa: PLC0415
        overlays,
        refuse_edited,
        remove,
    )
    from play_launch.graph_daemon.patch.target import find_target  # noqa: PLC0415

    try:
        found = overlays(find_target(python, needs_ros2cli=False))
        if not found:
            say("not patched; nothing to do")
            return
        for place, manifest in found:
            refuse_edited(place, manifest, force=force)
            if not dry_run:
                remove(place, manifest, force=force)
            say(f"{'would remove' if dry_run else 'removed'} from {place}:")
            for name in manifest.files:
                say(f"  {name}")
    except PatchError as error:
        _fail(error)
    if not dry_run:
        say(_RESTART)


def _fail(error: PatchError) -> NoReturn:
    from play_launch.graph_daemon.patch import VerificationError  # noqa: PLC0415

    failed = isinstance(error, VerificationError)
    fail(str(error), ExitCode.NODE_FAILED if failed else ExitCode.USAGE)
