"""``play-launch launch``: a launch file is evaluated and brought up, without a configuration."""

from __future__ import annotations

import os
import shlex
import tempfile
from pathlib import Path
from typing import Annotated

import typer

from play_launch.cli import shared_options as options  # noqa: TC001 - typer evaluates them
from play_launch.cli.failure import fail
from play_launch.cli.target import (
    USUAL_LIMIT,
    complain,
    evaluated,
    report_losses,
    say_arguments,
    sizes,
    target_of,
    unread,
)
from play_launch.launch_files.configuration.options import Containers, Options
from play_launch.systemd.notification import claim


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
    timeout: options.EvaluationTimeout = USUAL_LIMIT,
    log_dir: options.LogDir = None,
    duration: options.Duration = None,
    quiet: options.Quiet = False,
    as_json: options.EventsAsJson = False,
) -> None:
    """Evaluate a launch file, bring up what it describes, and record it, as `ros2 launch` would.

    Everything else is as with `replay`: `dump` writes the configuration that is used.
    """
    # What the launch file starts while it is evaluated is no service either.
    manager = claim(os.environ)
    found = target_of(target)
    description = evaluated(found, timeout, only_arguments=show_args)
    if show_args:
        say_arguments(description.arguments)
        return
    for name in unread(found, description):
        complain(f"note: no launch file declares the argument {name}")
    from play_launch.launch_files.configuration.write import written  # noqa: PLC0415

    with tempfile.TemporaryDirectory(prefix="play-launch-") as name:
        folder = Path(name)
        chosen = Options(containers=container_type, folder=folder, files=folder / "files")
        made = written(
            description, chosen, f"From {shlex.join(found.words)}, by play-launch launch."
        )
        report_losses(made)
        complain(sizes(made))
        if made.problems:
            fail(
                "the launch file describes something that cannot be brought up; nothing was started"
            )
        if strict and made.lost:
            fail("something gets lost; nothing was started")
        config = folder / f"{found.name}.yaml"
        config.write_text(made.text, encoding="utf-8")
        for path, content in made.files.items():
            path.parent.mkdir(exist_ok=True)
            path.write_bytes(content)
        if dry_run:
            from play_launch.cli.find_mistakes import find_mistakes  # noqa: PLC0415

            # What cannot be started is reported; a dry run starts nothing in any case.
            raise typer.Exit(find_mistakes(config, explain=True, as_json=as_json))
        from play_launch.cli.bring_up import bring_up  # noqa: PLC0415

        raise typer.Exit(
            bring_up(config, log_dir, duration, quiet=quiet, as_json=as_json, manager=manager)
        )
