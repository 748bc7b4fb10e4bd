"""``play-launch check``, as typer sees it; `find_mistakes` does it."""

from __future__ import annotations

from pathlib import Path  # noqa: TC003 - typer evaluates the annotations
from typing import Annotated

import typer

from play_launch.cli.find_mistakes import GraphForm, find_mistakes


def check(  # noqa: PLR0917 - typer calls it by keywords
    config: Annotated[
        Path, typer.Argument(metavar="CONFIG", help="The YAML file.", show_default=False)
    ],
    arguments: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[NAME:=VALUE]...",
            help="Arguments of the configuration, which are ${arg:NAME} in there.",
            show_default=False,
        ),
    ] = None,
    as_json: Annotated[
        bool,
        typer.Option(
            "--json", help="One JSON object on stdout: the problems, or the resolved configuration."
        ),
    ] = False,
    graph: Annotated[
        bool, typer.Option("--graph", help="Print what waits for what (depends_on).")
    ] = False,
    explain: Annotated[
        bool,
        typer.Option(
            "--explain",
            help="Print the resolved configuration, and the command and environment of each "
            "process that replay would start.",
        ),
    ] = False,
    form: Annotated[
        GraphForm | None,
        typer.Option("--format", help="Of the graph: text (default), or mermaid, a flow chart."),
    ] = None,
) -> None:
    """Find mistakes in a configuration; start nothing.

    Every problem is named with its place, `file:line:column: path: message`. Exits with 0 when
    there is none, else with 2.
    """
    drawn = (form or GraphForm.TEXT) if graph else None
    raise typer.Exit(
        find_mistakes(
            config, arguments=arguments or (), as_json=as_json, graph=drawn, explain=explain
        )
    )
