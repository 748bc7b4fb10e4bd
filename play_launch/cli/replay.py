"""``play-launch replay``, as typer sees it; `bring_up` does it."""

from __future__ import annotations

from pathlib import Path  # noqa: TC003 - typer evaluates the annotations
from typing import Annotated

import typer

from play_launch.cli.bring_up import bring_up


def replay(  # noqa: PLR0917 - typer calls it by keywords
    config: Annotated[
        Path,
        typer.Argument(
            metavar="CONFIG",
            help="The YAML file, or the session.mcap of a session to start again.",
            show_default=False,
        ),
    ],
    arguments: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[NAME:=VALUE]...",
            help="Arguments of the configuration, which are ${arg:NAME} in there.",
            show_default=False,
        ),
    ] = None,
    log_dir: Annotated[
        Path | None,
        typer.Option(
            help="Where to make the folder of this session; by default what the configuration "
            "says, else $PLAY_LAUNCH_LOG_DIR, else $ROS_LOG_DIR/play_launch, else "
            "~/.ros/play_launch.",
            metavar="DIR",
            show_default=False,
        ),
    ] = None,
    duration: Annotated[
        str | None,
        typer.Option(
            help="Stop after this time: 10s, 2min, 1h. Without it the system runs until Ctrl-C.",
            metavar="TIME",
            show_default=False,
        ),
    ] = None,
    quiet: Annotated[
        bool, typer.Option("--quiet", "-q", help="Do not show what nodes print; it is recorded.")
    ] = False,
    as_json: Annotated[
        bool,
        typer.Option("--json", help="Show events as JSON, one object a line, for programs."),
    ] = False,
    watch: Annotated[
        bool,
        typer.Option(
            "--watch", help="Apply the configuration whenever it, or a file it names, changes."
        ),
    ] = False,
) -> None:
    """Bring up a system, keep it running, record it.

    Containers start in parallel and load their nodes; dead ones are brought back within the limits
    of the configuration. Ctrl-C (or SIGTERM, SIGHUP) stops everything in order, a second one
    hurries. At the end a table says what was up, and where the recording is: an MCAP file that
    `ros2 bag info`, Foxglove and PlotJuggler read.

    From a recording, the system starts again as it was configured then: the configuration and the
    parameter files are in it. What differs on this machine is reported.

    With a mistake in the configuration nothing is started; every problem is named with its place.
    """
    raise typer.Exit(
        bring_up(
            config,
            log_dir,
            duration,
            arguments=arguments or (),
            quiet=quiet,
            as_json=as_json,
            watch=watch,
        )
    )
