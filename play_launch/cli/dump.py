"""``play-launch dump``: a launch file becomes a configuration."""

from __future__ import annotations

import json
import shlex
from pathlib import Path
from typing import Annotated

import typer

from play_launch.cli.show.terminal import say
from play_launch.cli.target import (
    argument_values,
    complain,
    evaluated,
    say_arguments,
    target_of,
    unread,
)
from play_launch.launch_files.configuration.options import Containers, Options

TARGET = typer.Argument(
    metavar="(PKG FILE | PATH) [NAME:=VALUE]...",
    help="A launch file, and its arguments.",
    show_default=False,
)
CONTAINER_TYPE = typer.Option(
    "--container-type",
    help="Of the containers of rclcpp_components: isolated gives each node a process of its own, "
    "stock keeps their programs, same takes ours that do the same.",
)


def dump(  # noqa: PLR0917 - typer calls it by keywords
    target: Annotated[list[str], TARGET],
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="CONFIG",
            help="Where to write the configuration; by default to stdout.",
            show_default=False,
        ),
    ] = None,
    container_type: Annotated[Containers, CONTAINER_TYPE] = Containers.SAME,
    inline: Annotated[
        bool, typer.Option("--inline", help="Copy parameter files, instead of naming them.")
    ] = False,
    strict: Annotated[
        bool,
        typer.Option("--strict", help="Write nothing, and exit with 2, if anything gets lost."),
    ] = False,
    show_args: Annotated[
        bool, typer.Option("--show-args", "-s", help="Print which arguments it takes.")
    ] = False,
    as_json: Annotated[
        bool, typer.Option("--json", help="One JSON object on stdout, the configuration in it.")
    ] = False,
) -> None:
    """Evaluate a launch file and write what it would start as a configuration; start nothing.

    By ROS's own launch where that is installed; otherwise launch files in XML and YAML. What the
    configuration does not say is reported with file and line. Exits with 2 if the launch file
    cannot be evaluated, or the result has mistakes that `check` finds.
    """
    from play_launch.cli.hand_over import hand_over  # noqa: PLC0415 - after --show-args
    from play_launch.launch_files.configuration.write import written  # noqa: PLC0415

    found = target_of(target)
    description = evaluated(found, only_arguments=show_args)
    arguments = argument_values(description.arguments)
    if show_args:
        if as_json:
            say(json.dumps({"arguments": arguments}, ensure_ascii=False))
        else:
            say_arguments(description.arguments)
        return
    for name in unread(found, description):
        complain(f"note: no launch file declares the argument {name}")
    folder = Path.cwd() if output is None else output.absolute().parent
    options = Options(containers=container_type, inline=inline, folder=folder)
    heading = f"From {shlex.join(found.words)}, by play-launch dump."
    made = written(description, options, heading)
    more = {"arguments": arguments, "files": description.files}
    hand_over(made, output, strict=strict, as_json=as_json, more=more)
