"""``play-launch check``: find mistakes in a configuration without starting anything."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path  # noqa: TC003 - typer evaluates the annotations
from typing import TYPE_CHECKING, Annotated

import typer

from play_launch.cli.failure import tell
from play_launch.cli.show.terminal import say
from play_launch.core.exit_code import ExitCode

if TYPE_CHECKING:
    from play_launch.config import ReplayConfig


def check(
    config: Annotated[
        Path, typer.Argument(metavar="CONFIG", help="The YAML file.", show_default=False)
    ],
    as_json: Annotated[
        bool,
        typer.Option(
            "--json", help="One JSON object on stdout: the problems, or the resolved configuration."
        ),
    ] = False,
) -> None:
    """Find mistakes in a configuration; start nothing.

    Every problem is named with its place, `file:line:column: path: message`. Exits with 0 when
    there is none, else with 2.
    """
    from play_launch.config import ConfigError, load_config  # noqa: PLC0415

    try:
        loaded = load_config(config)
    except ConfigError as error:
        if as_json:
            problems = [asdict(problem) for problem in error.problems]
            say(json.dumps({"valid": False, "problems": problems}, ensure_ascii=False))
        else:
            tell(f"{config} cannot be used\n{error.for_people()}")
        raise typer.Exit(ExitCode.USAGE) from None
    if as_json:
        from play_launch.config.description import describe as describe_values  # noqa: PLC0415

        values = {"valid": True, "problems": [], "config": describe_values(loaded)}
        say(json.dumps(values, ensure_ascii=False))
    else:
        say(f"{config}: {describe(loaded)}")


def describe(config: ReplayConfig) -> str:
    """Say how big a system is: ``2 containers with 7 nodes, 1 process``."""
    nodes = sum(len(container.composable_nodes) for container in config.containers)
    parts = []
    if config.containers or not config.nodes:
        containers = counted(len(config.containers), "container")
        parts.append(f"{containers} with {counted(nodes, 'node')}")
    if config.nodes:
        parts.append(counted(len(config.nodes), "process"))
    return ", ".join(parts)


def counted(number: int, noun: str) -> str:
    """``1 node``, ``2 nodes``, ``3 processes``."""
    plural = f"{noun}es" if noun.endswith("s") else f"{noun}s"
    return f"{number} {noun if number == 1 else plural}"
