"""``play-launch dump``: a launch file becomes a configuration."""

from __future__ import annotations

import json
import shlex
from pathlib import Path  # noqa: TC003 - typer evaluates the annotations
from typing import Annotated

import typer

from play_launch.cli import shared_options as options  # noqa: TC001 - typer evaluates them
from play_launch.cli.show.terminal import say
from play_launch.cli.target import (
    USUAL_LIMIT,
    Target,
    argument_values,
    complain,
    evaluated,
    say_arguments,
    target_of,
    unread,
)
from play_launch.launch_files.configuration.options import Containers, Options


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
    timeout: options.EvaluationTimeout = USUAL_LIMIT,
    as_json: options.ConfigurationAsJson = False,
) -> None:
    """Evaluate a launch file and write what it would start as a configuration; start nothing.

    By ROS's own launch where that is installed; otherwise launch files in XML and YAML. What the
    configuration does not say is reported with file and line. Exits with 2 if the launch file
    cannot be evaluated, or the result has mistakes that `check` finds. What the launch file keeps
    in temporary files, and long texts, are written into a folder beside the configuration.
    """
    from play_launch.cli.hand_over import hand_over  # noqa: PLC0415 - after --show-args
    from play_launch.launch_files.configuration.write import written  # noqa: PLC0415

    found = target_of(target)
    description = evaluated(found, timeout, only_arguments=show_args)
    arguments = argument_values(description.arguments)
    if show_args:
        if as_json:
            say(json.dumps({"arguments": arguments}, ensure_ascii=False))
        else:
            say_arguments(description.arguments)
        return
    for name in unread(found, description):
        complain(f"note: no launch file declares the argument {name}")
    made = written(description, _options(output, container_type, inline=inline), _heading(found))
    more = {"arguments": arguments, "files": description.files}
    hand_over(made, output, strict=strict, as_json=as_json, more=more)


def _heading(target: Target) -> str:
    return f"From {shlex.join(target.words)}, by play-launch dump."


def _options(output: Path | None, container_type: Containers, *, inline: bool) -> Options:
    if output is None or (output.exists() and not output.is_file()):
        # Nothing can stand beside what goes to stdout, or to a device.
        return Options(containers=container_type, inline=inline)
    folder = output.absolute().parent
    files = folder / f"{output.stem or output.name}.files"
    return Options(containers=container_type, inline=inline, folder=folder, files=files)
