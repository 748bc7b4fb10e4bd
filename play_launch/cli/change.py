"""``play-launch diff`` and ``play-launch apply``."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from play_launch.cli.operate import FAILED, OK, seconds
from play_launch.cli.output import is_terminal, printable, wants_colour
from play_launch.cli.show.plan_text import outcome_line, plan_lines
from play_launch.control.protocol import ControlError

if TYPE_CHECKING:
    from argparse import ArgumentParser, Namespace

    from play_launch.control.client import ControlClient

DIFFERS: Final = 1
_USUAL_LIMIT: Final = 60.0
_NOWHERE: Final = Path("/launch file")
"""Where a configuration that is no file stands, so that all paths in it are absolute."""


def add_arguments(parser: ArgumentParser, verb: str) -> None:
    """Declare what it takes."""
    parser.add_argument(
        "target",
        nargs="+",
        metavar="CONFIG",
        help="the YAML file, a launch file of ROS, or a package and a launch file; then "
        "NAME:=VALUE for its arguments",
    )
    parser.add_argument(
        "--container-type",
        choices=("same", "isolated", "stock"),
        default="same",
        help="of a launch file's containers, as for launch (same)",
    )
    if verb == "apply":
        parser.add_argument(
            "--timeout",
            type=seconds,
            default=_USUAL_LIMIT,
            metavar="S",
            help=f"seconds for each step ({_USUAL_LIMIT:g})",
        )
        parser.add_argument(
            "--rollback-on-failure",
            action="store_true",
            help="apply the configuration of before again when a step fails",
        )
        parser.add_argument(
            "--dry-run", action="store_true", help="say what would be done, as diff does"
        )


def run(client: ControlClient, options: Namespace) -> int:
    """Compare or change, and print the plan and the result of each step."""
    request = _configuration(options)
    if options.verb == "diff" or options.dry_run:
        compared = client.ask("apply", {**request, "dry_run": True})
        _print_plan(compared["plan"], compared["applying"], options)
        differs = compared["plan"]["steps"] or compared["applying"] is not None
        return DIFFERS if differs and options.verb == "diff" else OK
    request |= {"timeout": options.timeout, "rollback_on_failure": options.rollback_on_failure}
    try:
        for message in client.stream("apply", request):
            if "plan" in message and not options.json:
                _print_plan(message["plan"], None, options)
            elif "step" in message:
                _print_outcome(message["step"], options)
            elif "result" in message:
                _print_json(message["result"]["applied"], options)
                return OK
    except ControlError as error:
        _print_json(error.details.get("applied"), options)
        raise
    _report("the session ended before everything was applied")
    return FAILED


def _configuration(options: Namespace) -> dict[str, Any]:
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


def _evaluated(options: Namespace) -> tuple[str, str]:
    """Convert a launch file as `launch` does, but without other files; return name and text."""
    from play_launch.cli.target import (  # noqa: PLC0415 - takes its time
        USUAL_LIMIT,
        evaluated,
        report_losses,
        target_of,
    )
    from play_launch.launch_files.configuration.options import Containers, Options  # noqa: PLC0415
    from play_launch.launch_files.configuration.write import written  # noqa: PLC0415

    found = target_of(options.target)
    chosen = Options(containers=Containers(options.container_type), folder=_NOWHERE)
    made = written(evaluated(found, USUAL_LIMIT), chosen, "")
    report_losses(made)
    return str(_NOWHERE / f"{found.name}.yaml"), made.text


def _print_plan(plan: Any, applying: Any, options: Namespace) -> None:
    if options.json:
        sys.stdout.write(f"{json.dumps({**plan, 'applying': applying})}\n")
        return
    colour = is_terminal(sys.stdout) and wants_colour(sys.stdout)
    for line in plan_lines(plan, colour=colour, applying=applying):
        sys.stdout.write(f"{printable(line, colour=colour)}\n")
    sys.stdout.flush()


def _print_outcome(outcome: Any, options: Namespace) -> None:
    if not options.json:
        sys.stdout.write(f"{printable(outcome_line(outcome), colour=False)}\n")
        sys.stdout.flush()


def _print_json(applied: Any, options: Namespace) -> None:
    if options.json and applied is not None:
        sys.stdout.write(f"{json.dumps(applied)}\n")


def _report(message: str) -> None:
    sys.stderr.write(f"error: {message}\n")
