"""``play-launch info``, ``inspect`` and ``recover``, as typer sees them."""

from __future__ import annotations

from pathlib import Path  # noqa: TC003 - typer evaluates the annotations
from typing import Annotated

import typer


def info(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="A session.mcap.", show_default=False)
    ],
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object, for programs.")] = False,
) -> None:
    """Summarise a recording: session, duration, nodes, crashes, restarts, messages of each topic.

    It reads damaged and unfinished recordings (.active) as far as that is possible, and then exits
    with 3; with 2 when the file is not a recording, else with 0.
    """
    from play_launch.cli.sum_up import sum_up  # noqa: PLC0415 - slow, and not for --help

    raise typer.Exit(sum_up(file, as_json=as_json))


def inspect(  # noqa: PLR0917 - options, by name
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="A session.mcap.", show_default=False)
    ],
    node: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="Only this node, container or process; * and ? are patterns. May be repeated.",
            show_default=False,
        ),
    ] = None,
    level: Annotated[
        str, typer.Option(metavar="LEVEL", help="debug, info, warn, error or fatal, and above.")
    ] = "info",
    since: Annotated[
        str | None,
        typer.Option(
            metavar="TIME",
            help="From this time after the start (12.5s, 2min) or of the day (14:03:07) on.",
            show_default=False,
        ),
    ] = None,
    until: Annotated[
        str | None,
        typer.Option(metavar="TIME", help="Up to this time.", show_default=False),
    ] = None,
    around: Annotated[
        str | None,
        typer.Option(
            metavar="TIME", help="Five seconds before and after this time.", show_default=False
        ),
    ] = None,
    as_json: Annotated[
        bool,
        typer.Option("--json", help="Events as JSON, one object a line, as of replay --json."),
    ] = False,
) -> None:
    """Show what happened: starts, loads, crashes with their backtraces, restarts, output and log.

    Times are seconds after the start. It reads damaged and unfinished recordings (.active) as far
    as that is possible, and then exits with 3; with 2 when the file is not a recording, else 0.
    """
    from play_launch.cli.timeline import Filter, show_timeline  # noqa: PLC0415 - as above

    chosen = Filter(tuple(node or ()), level, since, until, around)
    raise typer.Exit(show_timeline(file, chosen, as_json=as_json))


def recover(
    file: Annotated[
        Path,
        typer.Argument(
            metavar="FILE", help="A session.mcap.active, or a damaged .mcap.", show_default=False
        ),
    ],
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="FILE",
            help="Where to write it; by default the name without .active, or x.recovered.mcap.",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Write what can be read of a recording to a new file, with an index.

    The file itself stays as it is. Exits with 0 when nothing was lost, with 3 when something could
    not be read, with 1 when nothing was written. A recording that is being written is refused.
    """
    from play_launch.cli.write_anew import write_anew  # noqa: PLC0415 - as above

    raise typer.Exit(write_anew(file, output))
