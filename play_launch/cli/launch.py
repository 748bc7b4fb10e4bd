"""``play-launch launch``: a launch file is evaluated and brought up, without a configuration."""

from __future__ import annotations

import shlex
import tempfile
from pathlib import Path
from typing import Annotated

import typer

from play_launch.cli.dump import CONTAINER_TYPE, TARGET
from play_launch.cli.failure import fail
from play_launch.cli.target import (
    Target,
    complain,
    evaluated,
    report_losses,
    say_arguments,
    sizes,
    target_of,
    unread,
)
from play_launch.core.exit_code import ExitCode
from play_launch.launch_files.configuration.options import Containers, Options


def launch(  # noqa: PLR0917 - typer calls it by keywords
    target: Annotated[list[str], TARGET],
    container_type: Annotated[Containers, CONTAINER_TYPE] = Containers.SAME,
    dry_run: Annotated[
        bool,
        typer.Option(
            "--dry-run", "-n", help="Print what would be started, with commands; start nothing."
        ),
    ] = False,
    strict: Annotated[
        bool,
        typer.Option("--strict", help="Start nothing, and exit with 2, if anything gets lost."),
    ] = False,
    show_args: Annotated[
        bool, typer.Option("--show-args", "-s", help="Print which arguments it takes.")
    ] = False,
    log_dir: Annotated[
        Path | None,
        typer.Option(help="As of replay.", metavar="DIR", show_default=False),
    ] = None,
    duration: Annotated[
        str | None,
        typer.Option(
            help="Stop after this time: 10s, 2min, 1h.", metavar="TIME", show_default=False
        ),
    ] = None,
    quiet: Annotated[
        bool, typer.Option("--quiet", "-q", help="Do not show what nodes print; it is recorded.")
    ] = False,
    as_json: Annotated[
        bool,
        typer.Option("--json", help="Show events as JSON, one object a line, for programs."),
    ] = False,
) -> None:
    """Evaluate a launch file, bring up what it describes, and record it, as `ros2 launch` would.

    Everything else is as with `replay`: `dump` writes the configuration that is used.
    """
    found = target_of(target)
    description = evaluated(found, only_arguments=show_args)
    if show_args:
        say_arguments(description.arguments)
        return
    for name in unread(found, description):
        complain(f"note: no launch file declares the argument {name}")
    from play_launch.launch_files.configuration.write import written  # noqa: PLC0415

    # Relative paths of parameter files start at the configuration, which stands elsewhere.
    options = Options(containers=container_type, folder=Path(tempfile.gettempdir(), "-"))
    made = written(description, options, f"From {shlex.join(found.words)}, by play-launch launch.")
    report_losses(made)
    complain(sizes(made))
    if made.problems:
        fail("the launch file describes something that cannot be brought up; nothing was started")
    if strict and made.lost:
        fail("something gets lost; nothing was started")
    raise typer.Exit(_bring_up(made.text, found, log_dir, duration, dry_run, quiet, as_json))


def _bring_up(  # noqa: PLR0917 - the options of launch
    text: str,
    found: Target,
    log_dir: Path | None,
    duration: str | None,
    dry_run: bool,
    quiet: bool,
    as_json: bool,
) -> int:
    with tempfile.TemporaryDirectory(prefix="play-launch-") as folder:
        config = Path(folder) / f"{found.name}.yaml"
        config.write_text(text, encoding="utf-8")
        if dry_run:
            from play_launch.cli.find_mistakes import find_mistakes  # noqa: PLC0415

            # What cannot be started is reported; a dry run starts nothing in any case.
            return find_mistakes(config, explain=True, as_json=as_json)
        from play_launch.cli.bring_up import bring_up  # noqa: PLC0415

        return bring_up(config, log_dir, duration, quiet=quiet, as_json=as_json) or ExitCode.OK
