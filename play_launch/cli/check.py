"""``play-launch check``, as typer sees it; `find_mistakes` does it."""

from __future__ import annotations

from typing import Annotated

import typer

from play_launch.cli import shared_options as options  # noqa: TC001 - typer evaluates them
from play_launch.cli.find_mistakes import GraphForm, find_mistakes


def check(  # noqa: PLR0917 - typer calls it by keywords
    config: options.ConfigFile,
    arguments: options.ConfigArguments = None,
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
