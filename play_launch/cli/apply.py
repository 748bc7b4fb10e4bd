"""``play-launch diff`` and ``play-launch apply``."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, NamedTuple

import typer

from play_launch.cli import options as cli_options
from play_launch.cli.connection import connected, report
from play_launch.cli.output import is_terminal, printable, wants_colour
from play_launch.cli.show.plan_text import outcome_line, plan_lines
from play_launch.control.protocol import ControlError
from play_launch.launch_files.configuration.options import Containers
from play_launch.supervisor.exit_code import ExitCode

if TYPE_CHECKING:
    from play_launch.control.client import ControlClient

_NOWHERE: Final = Path("/launch file")
"""Where a configuration that is no file stands, so that all paths in it are absolute."""


Target = Annotated[
    list[str],
    typer.Argument(
        metavar="CONFIG [NAME:=VALUE]...",
        help="The YAML file, a launch file of ROS, or a package and a launch file; then arguments.",
        show_default=False,
        autocompletion=cli_options.complete_launch_file,
    ),
]
ContainerType = Annotated[
    Containers, typer.Option(help="Containers of a launch file, as for launch.")
]


class _Options(NamedTuple):
    target: list[str]
    container_type: Containers
    as_json: bool


def diff(
    target: Target,
    container_type: ContainerType = Containers.SAME,
    session: cli_options.Session = None,
    as_json: cli_options.Json = False,
) -> int:
    """Print what apply would change; exits with 1 if anything differs, with 2 after an error."""
    options = _Options(target, container_type, as_json)
    with connected(session, failed=ExitCode.USAGE) as client:
        compared = client.ask("apply", {**_configuration(options), "dry_run": True})
        _print_plan(compared["plan"], compared["applying"], options)
    differs = compared["plan"]["steps"] or compared["applying"] is not None
    return ExitCode.NODE_FAILED if differs else ExitCode.OK


def apply(  # noqa: PLR0917 - options, by name
    target: Target,
    container_type: ContainerType = Containers.SAME,
    timeout: Annotated[float, cli_options.timeout("Limit for each step.", "60s")] = 60.0,
    rollback_on_failure: Annotated[
        bool,
        typer.Option(
            "--rollback-on-failure", help="If a step fails, apply the previous configuration again."
        ),
    ] = False,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Print the changes only, as diff does.")
    ] = False,
    session: cli_options.Session = None,
    as_json: cli_options.Json = False,
) -> int:
    """Change a session to match a configuration; what does not differ continues to run."""
    options = _Options(target, container_type, as_json)
    with connected(session) as client:
        request = _configuration(options)
        if dry_run:
            compared = client.ask("apply", {**request, "dry_run": True})
            _print_plan(compared["plan"], compared["applying"], options)
            return ExitCode.OK
        request |= {"timeout": timeout, "rollback_on_failure": rollback_on_failure}
        return _apply(client, request, options)


def _apply(client: ControlClient, request: dict[str, Any], options: _Options) -> int:
    try:
        for message in client.stream("apply", request):
            if "plan" in message and not options.as_json:
                _print_plan(message["plan"], None, options)
            elif "step" in message:
                _print_outcome(message["step"], options)
            elif "result" in message:
                _print_json(message["result"]["applied"], options)
                return ExitCode.OK
    except ControlError as error:
        _print_json(error.details.get("applied"), options)
        raise
    report("the session ended before everything was applied")
    return ExitCode.NODE_FAILED


def _configuration(options: _Options) -> dict[str, Any]:
    """Name the configuration for the session, with environment and directory of this process."""
    named = [each for each in options.target if ":=" not in each]
    environment = dict(os.environ)
    if _is_launch_file(named):
        path, text = _evaluated(options)
        return {"path": path, "text": text, "environment": environment}
    path, *arguments = options.target
    return {"path": os.path.abspath(path), "arguments": arguments, "environment": environment}  # noqa: PTH100 - without resolving links


def _is_launch_file(named: list[str]) -> bool:
    from play_launch.launch_files.find import is_launch_file  # noqa: PLC0415 - takes its time

    path = Path(named[0]) if named else None
    if path is not None and path.is_file():
        return is_launch_file(path)
    return len(named) != 1


def _evaluated(options: _Options) -> tuple[str, str]:
    """Convert a launch file as `launch` does, but without other files; return name and text."""
    from play_launch.cli.target import (  # noqa: PLC0415 - takes its time
        USUAL_TIMEOUT,
        evaluated,
        report_losses,
        target_of,
    )
    from play_launch.launch_files.configuration.options import Options  # noqa: PLC0415
    from play_launch.launch_files.configuration.write import written  # noqa: PLC0415

    found = target_of(options.target)
    chosen = Options(containers=options.container_type, folder=_NOWHERE)
    made = written(evaluated(found, USUAL_TIMEOUT), chosen, "")
    report_losses(made)
    return str(_NOWHERE / f"{found.name}.yaml"), made.text


def _print_plan(plan: Any, applying: Any, options: _Options) -> None:
    if options.as_json:
        sys.stdout.write(f"{json.dumps({**plan, 'applying': applying})}\n")
        return
    colour = is_terminal(sys.stdout) and wants_colour(sys.stdout)
    for line in plan_lines(plan, colour=colour, applying=applying):
        sys.stdout.write(f"{printable(line, colour=colour)}\n")
    sys.stdout.flush()


def _print_outcome(outcome: Any, options: _Options) -> None:
    if not options.as_json:
        sys.stdout.write(f"{printable(outcome_line(outcome), colour=False)}\n")
        sys.stdout.flush()


def _print_json(applied: Any, options: _Options) -> None:
    if options.as_json and applied is not None:
        sys.stdout.write(f"{json.dumps(applied)}\n")
