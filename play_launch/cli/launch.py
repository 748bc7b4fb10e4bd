"""``play-launch launch``, as typer sees it; `bring_up_launch_file` does it."""

from __future__ import annotations

from typing import Annotated

import typer

from play_launch.cli import shared_options as options  # noqa: TC001 - typer evaluates them
from play_launch.cli.bring_up_launch_file import bring_up_launch_file
from play_launch.cli.target import USUAL_LIMIT
from play_launch.launch_files.configuration.options import Containers


def launch(  # noqa: PLR0917 - typer calls it by keywords
    target: options.LaunchFile,
    container_type: options.ContainerType = Containers.SAME,
    dry_run: Annotated[
        bool,
        typer.Option(
            "--dry-run", "-n", help="Print what would be started, with commands; start nothing."
        ),
    ] = False,
    strict: options.Strict = False,
    show_args: options.ShowArgs = False,
    launch_prefix: options.LaunchPrefix = "",
    launch_prefix_filter: options.LaunchPrefixFilter = "",
    show_all: options.ShowAllOutput = False,
    timeout: options.EvaluationTimeout = USUAL_LIMIT,
    log_dir: options.LogDir = None,
    duration: options.Duration = None,
    quiet: options.Quiet = False,
    as_json: options.EventsAsJson = False,
) -> None:
    """Evaluate a launch file, bring up what it describes, and record it, as `ros2 launch` would.

    Everything else is as with `replay`: `dump` writes the configuration that is used.
    """
    raise typer.Exit(
        bring_up_launch_file(
            target,
            container_type=container_type,
            dry_run=dry_run,
            strict=strict,
            show_args=show_args,
            launch_prefix=launch_prefix,
            launch_prefix_filter=launch_prefix_filter,
            show_all=show_all,
            timeout=timeout,
            log_dir=log_dir,
            duration=duration,
            quiet=quiet,
            as_json=as_json,
        )
    )
