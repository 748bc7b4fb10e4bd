"""``play-launch check``, as typer sees it; `find_mistakes` does it."""

from __future__ import annotations

from pathlib import Path  # noqa: TC003 - typer evaluates the annotations
from typing import Annotated

import typer

from play_launch.cli.find_mistakes import find_mistakes


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
    raise typer.Exit(find_mistakes(config, as_json=as_json))
