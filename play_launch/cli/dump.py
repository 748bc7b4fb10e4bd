"""What ``play-launch dump`` does: a launch file becomes a configuration."""

from __future__ import annotations

import json
import shlex
from pathlib import Path
from typing import Annotated

import typer
from msgspec.structs import replace

from play_launch import ExitCode
from play_launch.cli import options
from play_launch.cli.output import is_passed_on, say
from play_launch.cli.target import (
    USUAL_TIMEOUT,
    ContainerType,
    argument_values,
    evaluated,
    say_arguments,
)
from play_launch.launch_files.configuration.request import Containers, Options


def dump(  # noqa: PLR0917 - options, by name
    target: options.LaunchFile,
    output: options.Output = None,
    container_type: ContainerType = Containers.SAME,
    inline: Annotated[
        bool,
        typer.Option("--inline", help="Copy parameter files into the configuration."),
    ] = False,
    strict: options.Strict = False,
    show_args: options.ShowArgs = False,
    launch_prefix: options.LaunchPrefix = "",
    launch_prefix_filter: options.LaunchPrefixFilter = "",
    show_all: options.ShowAllOutput = False,
    timeout: options.EvaluationTimeout = USUAL_TIMEOUT,
    as_json: options.Json = False,
) -> int:
    """Convert a ROS launch file to a configuration; start nothing.

    ROS's own launch evaluates it, so launch_ros has to be installed.
    What cannot be converted is reported with file and line. Exits with 2 if the launch file cannot
    be evaluated, or the result has mistakes that `check` finds. Temporary files of the launch file,
    and long texts, are written into a folder beside the configuration.
    """
    from play_launch.cli.target import write_config  # noqa: PLC0415 - after --show-args
    from play_launch.launch_files.configuration.write import written  # noqa: PLC0415

    _, description = evaluated(
        target,
        timeout,
        only_arguments=show_args,
        launch_prefix=launch_prefix,
        launch_prefix_filter=launch_prefix_filter,
    )
    arguments = argument_values(description.arguments)
    if show_args:
        if as_json:
            say(json.dumps({"arguments": arguments}, ensure_ascii=False))
        else:
            say_arguments(description.arguments)
        return ExitCode.OK
    chosen = Options(containers=container_type, show_all=show_all, inline=inline)
    made = written(
        description,
        _placed(chosen, output),
        f"From {shlex.join(target)}, by play-launch dump.",
    )
    more = {"arguments": arguments, "files": description.files}
    return write_config(made, output, strict=strict, as_json=as_json, more=more)


def _placed(options: Options, output: Path | None) -> Options:
    if output is None or is_passed_on(output):
        # Nothing can stand beside what goes to stdout, or to a device.
        return options
    folder = output.absolute().parent
    return replace(options, folder=folder, files=folder / f"{output.stem or output.name}.files")
