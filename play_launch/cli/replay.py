"""``play-launch replay``, as typer sees it; `bring_up` does it."""

from __future__ import annotations

from pathlib import Path  # noqa: TC003 - typer evaluates the annotations
from typing import Annotated

import typer

from play_launch.cli import shared_options as options  # noqa: TC001 - typer evaluates them
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
    arguments: options.ConfigArguments = None,
    log_dir: options.LogDir = None,
    duration: options.Duration = None,
    quiet: options.Quiet = False,
    as_json: options.EventsAsJson = False,
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
