"""What ``play-launch launch`` does: a launch file is evaluated and brought up."""

from __future__ import annotations

import os
import shlex
import tempfile
from pathlib import Path
from typing import Annotated

import typer

from play_launch import ExitCode
from play_launch.cli import options
from play_launch.cli.output import fail, note
from play_launch.cli.target import (
    USUAL_TIMEOUT,
    ContainerType,
    evaluated,
    report_losses,
    say_arguments,
    sizes,
)
from play_launch.deploy.notification import claim
from play_launch.launch_files.configuration.request import Containers, Options


def launch(  # noqa: PLR0917 - options, by name
    target: options.LaunchFile,
    container_type: ContainerType = Containers.SAME,
    dry_run: Annotated[
        bool,
        typer.Option("--dry-run", "-n", help="Print the commands that would be started."),
    ] = False,
    strict: options.Strict = False,
    show_args: options.ShowArgs = False,
    launch_prefix: options.LaunchPrefix = "",
    launch_prefix_filter: options.LaunchPrefixFilter = "",
    show_all: options.ShowAllOutput = False,
    timeout: options.EvaluationTimeout = USUAL_TIMEOUT,
    log_dir: options.LogDir = None,
    duration: options.Duration = None,
    quiet: options.Quiet = False,
    as_json: options.Json = False,
) -> int:
    """Start a ROS launch file and record it, as `ros2 launch` would.

    Everything else is as with `replay`; `dump` writes the configuration that is used.
    """
    # What the launch file starts while it is evaluated is no service either.
    manager = claim(os.environ)
    name, description = evaluated(
        target,
        timeout,
        only_arguments=show_args,
        launch_prefix=launch_prefix,
        launch_prefix_filter=launch_prefix_filter,
    )
    if show_args:
        say_arguments(description.arguments)
        return ExitCode.OK
    from play_launch.launch_files.configuration.write import written  # noqa: PLC0415

    with tempfile.TemporaryDirectory(prefix="play-launch-") as temporary:
        folder = Path(temporary)
        chosen = Options(
            containers=container_type, show_all=show_all, folder=folder, files=folder / "files"
        )
        made = written(description, chosen, f"From {shlex.join(target)}, by play-launch launch.")
        report_losses(made)
        note(sizes(made))
        if made.problems:
            fail("what the launch file describes cannot be brought up; nothing was started")
        if strict and made.lost:
            fail("something gets lost; nothing was started")
        config = folder / f"{name}.yaml"
        config.write_text(made.text, encoding="utf-8")
        for path, content in made.files.items():
            path.parent.mkdir(exist_ok=True)
            path.write_bytes(content)
        if dry_run:
            from play_launch.cli.check import check  # noqa: PLC0415

            # What cannot be started is reported; a dry run starts nothing in any case.
            return check(config, explain=True, as_json=as_json)
        from play_launch.cli.replay import bring_up  # noqa: PLC0415

        return bring_up(config, log_dir, duration, quiet=quiet, as_json=as_json, manager=manager)
