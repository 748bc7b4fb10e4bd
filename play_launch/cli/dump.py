"""``play-launch dump``, as typer sees it; `dump_launch_file` does it."""

from __future__ import annotations

from typing import Annotated

import typer

from play_launch.cli import shared_options as options  # noqa: TC001 - typer evaluates them
from play_launch.cli.dump_launch_file import dump_launch_file
from play_launch.cli.target import USUAL_LIMIT
from play_launch.launch_files.configuration.options import Containers


def dump(  # noqa: PLR0917 - typer calls it by keywords
    target: options.LaunchFile,
    output: options.Output = None,
    container_type: options.ContainerType = Containers.SAME,
    inline: Annotated[
        bool,
        typer.Option(
            "--inline", help="Copy what is in parameter files, and write no files besides."
        ),
    ] = False,
    strict: options.Strict = False,
    show_args: options.ShowArgs = False,
    launch_prefix: options.LaunchPrefix = "",
    launch_prefix_filter: options.LaunchPrefixFilter = "",
    show_all: options.ShowAllOutput = False,
    timeout: options.EvaluationTimeout = USUAL_LIMIT,
    as_json: options.ConfigurationAsJson = False,
) -> None:
    """Evaluate a launch file and write what it would start as a configuration; start nothing.

    By ROS's own launch where that is installed; otherwise launch files in XML and YAML. What the
    configuration does not say is reported with file and line. Exits with 2 if the launch file
    cannot be evaluated, or the result has mistakes that `check` finds. What the launch file keeps
    in temporary files, and long texts, are written into a folder beside the configuration.
    """
    raise typer.Exit(
        dump_launch_file(
            target,
            output=output,
            container_type=container_type,
            inline=inline,
            strict=strict,
            show_args=show_args,
            launch_prefix=launch_prefix,
            launch_prefix_filter=launch_prefix_filter,
            show_all=show_all,
            timeout=timeout,
            as_json=as_json,
        )
    )
