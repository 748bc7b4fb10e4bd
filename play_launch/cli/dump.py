"""What ``play-launch dump`` does: a launch file becomes a configuration."""

from __future__ import annotations

import json
import shlex
from pathlib import Path  # noqa: TC003 - typer evaluates the annotations
from typing import TYPE_CHECKING, Annotated

import typer
from msgspec.structs import replace

from play_launch.cli import shared_options as options  # noqa: TC001 - typer evaluates them
from play_launch.cli.output import say
from play_launch.cli.target import (
    USUAL_LIMIT,
    Target,
    argument_values,
    evaluated,
    say_arguments,
    target_of,
)
from play_launch.launch_files.configuration.options import Containers, Options
from play_launch.postmortem.whole_file import is_passed_on
from play_launch.supervisor.exit_code import ExitCode

if TYPE_CHECKING:
    from collections.abc import Sequence


def dump_launch_file(
    target: Sequence[str],
    *,
    output: Path | None = None,
    container_type: Containers = Containers.SAME,
    inline: bool = False,
    strict: bool = False,
    show_args: bool = False,
    launch_prefix: str = "",
    launch_prefix_filter: str = "",
    show_all: bool = False,
    timeout: str = USUAL_LIMIT,
    as_json: bool = False,
) -> int:
    """Evaluate a launch file, write the configuration, and return the exit code."""
    from play_launch.cli.write_config import hand_over  # noqa: PLC0415 - after --show-args
    from play_launch.launch_files.configuration.write import written  # noqa: PLC0415

    found = target_of(
        target, launch_prefix=launch_prefix, launch_prefix_filter=launch_prefix_filter
    )
    description = evaluated(found, timeout, only_arguments=show_args)
    arguments = argument_values(description.arguments)
    if show_args:
        if as_json:
            say(json.dumps({"arguments": arguments}, ensure_ascii=False))
        else:
            say_arguments(description.arguments)
        return ExitCode.OK
    chosen = Options(containers=container_type, show_all=show_all, inline=inline)
    made = written(description, _placed(chosen, output), _heading(found))
    more = {"arguments": arguments, "files": description.files}
    return hand_over(made, output, strict=strict, as_json=as_json, more=more)


def _heading(target: Target) -> str:
    return f"From {shlex.join(target.words)}, by play-launch dump."


def _placed(options: Options, output: Path | None) -> Options:
    if output is None or is_passed_on(output):
        # Nothing can stand beside what goes to stdout, or to a device.
        return options
    folder = output.absolute().parent
    return replace(options, folder=folder, files=folder / f"{output.stem or output.name}.files")


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
