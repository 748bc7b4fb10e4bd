"""The launch file of a command line, and its arguments: ``PKG FILE name:=value`` or a path."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, TypeAlias

import typer
from msgspec import Struct

from play_launch.cli.output import counted, fail, note, say
from play_launch.launch_files.configuration.options import Containers

if TYPE_CHECKING:
    from collections.abc import Sequence

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


class Target(Struct, frozen=True):
    """A launch file, its arguments, and how it was named."""

    path: Path
    arguments: dict[str, str]
    words: tuple[str, ...]

    @property
    def name(self) -> str:
        """The name of the file without its endings, for a run."""
        return self.path.name.partition(".")[0] or "launch"


def target_of(
    words: Sequence[str], *, launch_prefix: str = "", launch_prefix_filter: str = ""
) -> Target:
    """Return what a command line names; mistakes end the process."""
    from play_launch.launch_files.find import find  # noqa: PLC0415 - not for other verbs

    named = [each for each in words if ":=" not in each]
    if len(named) not in (1, 2) or list(words[: len(named)]) != named:
        fail("give a launch file, or a package and a launch file, then name:=value")
    try:
        given = _arguments(words[len(named) :])
        # As `ros2 launch` hands them on.
        if launch_prefix:
            given["launch-prefix"] = launch_prefix
        if launch_prefix_filter:
            given["launch-prefix-filter"] = launch_prefix_filter
        return Target(Path.cwd() / find(named), given, tuple(words))
    except ValueError as error:
        fail(str(error))


def _arguments(texts: Sequence[str]) -> dict[str, str]:
    """Read `name:=value`; any name will do, as in launch. Raises ValueError."""
    found: dict[str, str] = {}
    for text in texts:
        name, _, value = text.partition(":=")
        if not name or ":=" not in text:
            raise ValueError(f"'{text}' is not an argument; write name:=value")
        if name in found:
            raise ValueError(f"the argument {name} is given twice")
        found[name] = value
    return found


def evaluated(target: Target, timeout: float, *, only_arguments: bool = False) -> Description:
    """Return what the launch file describes; mistakes end the process."""
    from play_launch.launch_files.ros_launch.evaluate import evaluate  # noqa: PLC0415

    try:
        found = evaluate(
            target.path, target.arguments, limit=timeout, only_arguments=only_arguments
        )
    except OSError as error:
        fail(f"{target.path} cannot be evaluated: {error}")
    if not only_arguments:
        declared = {*_OF_LAUNCH, *(each.name for each in found.arguments)}
        for name in target.arguments:
            if name not in declared:  # launch takes it without a word
                note(f"note: no launch file declares the argument {name}")
    return found


def say_arguments(arguments: Sequence[Argument]) -> None:
    """Print the arguments that a launch file takes."""
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
    """Return the arguments for programs."""
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
    for problem in written.problems:
        note(f"mistake in the result: {problem}")


def sizes(written: Written) -> str:
    """Say how much was written."""
    return (
        f"{counted(written.containers, 'container')} with "
        f"{counted(written.composable_nodes, 'node')}, {counted(written.processes, 'process')}; "
        f"{written.lost} not carried over"
    )
