"""The launch file of a command line, and its arguments: ``PKG FILE name:=value`` or a path."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, TypeAlias

import typer
from msgspec.structs import asdict

from play_launch import ExitCode
from play_launch.cli.output import (
    counted,
    fail,
    is_standard_output,
    make_folder,
    note,
    say,
    write_file,
)
from play_launch.config.substitutions import parse_arguments
from play_launch.launch_files.configuration.request import Containers

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from play_launch.launch_files.configuration.write import Written
    from play_launch.launch_files.records import Argument, Description


USUAL_TIMEOUT: Final = 120.0
"""Seconds for an evaluation; Autoware's largest takes a few seconds."""
ContainerType: TypeAlias = Annotated[
    Containers,
    typer.Option(
        "--container-type",
        help="For containers of rclcpp_components: isolated gives each node a process of its "
        "own, stock uses their programs, same uses ours with the same behaviour.",
    ),
]
_OF_LAUNCH: Final = frozenset(
    {
        "emulate_tty",
        "launch-prefix",
        "launch-prefix-filter",
        "sigkill_timeout",
        "sigterm_timeout",
    }
)
"""Arguments that hold for all processes; no launch file declares them."""


def evaluated(
    words: Sequence[str],
    timeout: float,
    *,
    only_arguments: bool = False,
    launch_prefix: str = "",
    launch_prefix_filter: str = "",
) -> tuple[str, Description]:
    """Evaluate the launch file that a command line names; mistakes end the process.

    Returns the name of the file without its endings, for a run, and what it describes.
    """
    from play_launch.launch_files.find import find  # noqa: PLC0415 - not for other verbs
    from play_launch.launch_files.ros_launch.evaluate import evaluate  # noqa: PLC0415

    named = [each for each in words if ":=" not in each]
    if len(named) not in (1, 2) or list(words[: len(named)]) != named:
        fail("give a launch file, or a package and a launch file, then name:=value")
    arguments = parse_arguments(words[len(named) :])
    try:
        path = Path.cwd() / find(named)
    except ValueError as error:
        fail(str(error))
    # As `ros2 launch` hands them on.
    if launch_prefix:
        arguments["launch-prefix"] = launch_prefix
    if launch_prefix_filter:
        arguments["launch-prefix-filter"] = launch_prefix_filter
    try:
        found = evaluate(path, arguments, limit=timeout, only_arguments=only_arguments)
    except OSError as error:
        fail(f"{path} cannot be evaluated: {error}")
    if not only_arguments:
        declared = {*_OF_LAUNCH, *(each.name for each in found.arguments)}
        for name in arguments:
            if name not in declared:  # launch takes it without a word
                note(f"note: no launch file declares the argument {name}")
    return path.name.partition(".")[0] or "launch", found


def say_arguments(arguments: Sequence[Argument]) -> None:
    if not arguments:
        say("it declares no arguments")
    for each in arguments:
        value = "required" if each.default is None else f"default: {each.default}"
        say(f"{each.name}  ({value})")
        if each.description:
            say(f"    {each.description}")
        if each.choices:
            say(f"    one of: {', '.join(each.choices)}")


def argument_values(arguments: Sequence[Argument]) -> list[dict[str, object]]:
    return [
        {
            "name": each.name,
            "default": each.default,
            "description": each.description,
            "choices": list(each.choices),
            "place": str(each.origin),
        }
        for each in arguments
    ]


def report_losses(written: Written) -> None:
    """Write to stderr what could not be carried over, and mistakes in the result."""
    for loss in written.losses:
        note(f"{'note' if loss.is_note else 'not carried over'}: {loss.where}: {loss.what}")
    if not written.containers and not written.processes:
        reason = "" if written.lost else ": conditions and arguments leave no program"
        note(f"nothing to start{reason}")
        return
    for problem in written.problems:
        note(f"mistake in the result: {problem}")


def sizes(written: Written) -> str:
    return (
        f"{counted(written.containers, 'container')} with "
        f"{counted(written.composable_nodes, 'node')}, {counted(written.processes, 'process')}; "
        f"{written.lost} not carried over"
    )


# The configuration that it becomes.


def write_config(
    made: Written,
    output: Path | None,
    *,
    strict: bool,
    as_json: bool,
    more: Mapping[str, object] | None = None,
) -> ExitCode:
    """Write the configuration, report what it does not say, and return the exit code.

    Without `output` it goes to stdout. With `strict` nothing is written when anything was lost.
    `more` goes into the JSON.
    """
    is_refused = strict and made.lost > 0
    if output is not None and is_standard_output(output):
        output = None
    if output is not None and not is_refused:
        for path, content in made.files.items():
            make_folder(path.parent)
            write_file(path, content)
        write_file(output, made.text)
    if as_json:
        say(json.dumps({**_values(made, output), **(more or {})}, ensure_ascii=False))
    else:
        if output is None and not is_refused:
            say(made.text.rstrip("\n"))
        report_losses(made)
        note(sizes(made))
    return ExitCode.USAGE if made.problems or is_refused else ExitCode.OK


def _values(made: Written, output: Path | None) -> dict[str, object]:
    return {
        "output": None if output is None else str(output),
        "config": made.text if output is None else None,
        "copies": [str(path) for path in made.files],
        "containers": made.containers,
        "composable_nodes": made.composable_nodes,
        "processes": made.processes,
        "lost": [
            {"where": each.where, "what": each.what} for each in made.losses if not each.is_note
        ],
        "notes": [{"where": each.where, "what": each.what} for each in made.losses if each.is_note],
        "problems": [asdict(problem) for problem in made.problems],
    }
