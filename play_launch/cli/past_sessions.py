"""The verbs about recordings, ``info`` to ``layout``, as typer sees them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, TypeAlias

import typer

Recording: TypeAlias = Annotated[
    Path,
    typer.Argument(
        metavar="FILE", help="A session.mcap, or the folder of a session.", show_default=False
    ),
]
AsJson: TypeAlias = Annotated[bool, typer.Option("--json", help="One JSON object, for programs.")]


def info(
    file: Recording,
    as_json: AsJson = False,
) -> None:
    """Summarise a recording: session, duration, nodes, crashes, restarts, messages of each topic.

    It reads damaged and unfinished recordings (.active) as far as that is possible, and then exits
    with 3; with 2 when the file is not a recording, else with 0.
    """
    from play_launch.cli.info import sum_up  # noqa: PLC0415 - slow, and not for --help

    raise typer.Exit(sum_up(file, as_json=as_json))


def inspect(  # noqa: PLR0917 - options, by name
    file: Recording,
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

    So are changes of parameters, and with --level debug the parameters that nodes answered with.

    Times are seconds after the start. It reads damaged and unfinished recordings (.active) as far
    as that is possible, and then exits with 3; with 2 when the file is not a recording, else 0.
    """
    from play_launch.cli.inspect import Filter, show_timeline  # noqa: PLC0415 - as above

    chosen = Filter(tuple(node or ()), level, since, until, around)
    raise typer.Exit(show_timeline(file, chosen, as_json=as_json))


def report(
    file: Recording,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="FILE",
            help="Where to write it; by default session.html beside the recording.",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Make a page of a recording: what happened, timeline, CPU and memory, log, configuration.

    It is one HTML file for any browser, and needs no network. A file of that name is replaced. It
    reads damaged and unfinished recordings (.active) as far as that is possible, says so on the
    page, and then exits with 3; with 2 when the file is not a recording, with 1 when the page
    cannot be written, else with 0.
    """
    from play_launch.cli.report import write_report  # noqa: PLC0415 - as above

    raise typer.Exit(write_report(file, output))


def explain(
    file: Recording,
    as_json: AsJson = False,
) -> None:
    """Say what went wrong in a session: what failed first, why, where, and who else was hit.

    Exits with 0 when nothing was wrong, with 1 when something was, with 2 when the file is not a
    recording, and with 3 when not all of it could be read, whatever the rest says. Source lines
    need addr2line (binutils) and the libraries of the session on this machine.
    """
    from play_launch.cli.explain import explain as explain_session  # noqa: PLC0415

    raise typer.Exit(explain_session(file, as_json=as_json))


def crashes(
    folder: Annotated[
        Path,
        typer.Argument(
            metavar="DIR", help="A log folder with sessions, or one file.", show_default=False
        ),
    ],
    as_json: AsJson = False,
) -> None:
    """Group the crashes of many sessions: equal ones have equal signatures.

    A signature is the signal or exception and the innermost functions of your own code, without
    addresses. Exits with 0, with 2 when there is no recording, with 3 when not all could be read.
    """
    from play_launch.cli.crashes import list_crashes  # noqa: PLC0415 - as above

    raise typer.Exit(list_crashes(folder, as_json=as_json))


def compare(
    first: Annotated[
        Path, typer.Argument(metavar="A", help="The session before.", show_default=False)
    ],
    second: Annotated[
        Path, typer.Argument(metavar="B", help="The session after.", show_default=False)
    ],
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="FILE",
            help="Write the same as a page, with all numbers, to this HTML file as well.",
            show_default=False,
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Compare two sessions: bring-up, restarts, crashes, memory and CPU of each member.

    Exits with 0 when the second is not worse, with 1 when it is: a new crash, a node that is not
    loaded any more, one more restart, or half as much again of time (and a second), memory (and
    64 MB) or CPU (and 10 % of a core). 2 and 3 as of explain; 1 also when the page cannot be
    written.
    """
    from play_launch.cli.compare import compare_sessions  # noqa: PLC0415 - as above

    raise typer.Exit(compare_sessions(first, second, output, as_json=as_json))


def rerun(
    file: Recording,
    until: Annotated[
        str | None,
        typer.Option(
            metavar="TIME",
            help="Only up to this time after the start (12.5s, 2min).",
            show_default=False,
        ),
    ] = None,
    diff: Annotated[
        bool, typer.Option("--diff", help="Show all differences, not only the first one.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Decide a session once more from its inputs, and report what this version decides otherwise.

    Nothing is started: what processes and nodes did is taken from the recording. Exits with 0 when
    all changes of state follow as they were recorded, with 1 when not, with 2 when the file is not
    a recording, and with 3 when inputs are missing, as in a recording of an older version.
    """
    from play_launch.cli.rerun import Choice, show_rerun  # noqa: PLC0415 - as above

    chosen = Choice(until, shows_all=diff, as_json=as_json)
    raise typer.Exit(show_rerun(file, chosen))


def recover(
    file: Annotated[
        Path,
        typer.Argument(
            metavar="FILE",
            help="A session.mcap.active, a damaged .mcap, or the folder of a session.",
            show_default=False,
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

    The file itself stays as it is. In a folder, files that were not completed are replaced by
    complete ones; one that is damaged within is kept as .damaged. Exits with 0 when nothing was
    lost, with 3 when something could not be read, with 1 when nothing was written. A recording that
    is being written is refused.
    """
    from play_launch.cli.recover import write_anew  # noqa: PLC0415 - as above

    raise typer.Exit(write_anew(file, output))


def export(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="A session.mcap.", show_default=False)
    ],
    form: Annotated[
        str,
        typer.Option(
            "--format",
            metavar="FORMAT",
            help="perfetto: a trace for Perfetto and chrome://tracing; csv or parquet: tables.",
        ),
    ] = "perfetto",
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="PATH",
            help="The file of a trace, the folder of tables; by default beside the recording.",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Write a recording in the format of another tool: what happened as a trace, or as tables.

    It reads damaged and unfinished recordings (.active) as far as that is possible, and then exits
    with 3; with 2 when the file is not a recording, with 1 when nothing could be written, else 0.
    """
    from play_launch.cli.export import export_session  # noqa: PLC0415 - as above

    raise typer.Exit(export_session(file, form, output))


def layout(
    tool: Annotated[
        str,
        typer.Argument(metavar="TOOL", help="foxglove or plotjuggler.", show_default=False),
    ],
    file: Annotated[
        Path | None,
        typer.Argument(
            metavar="[FILE]",
            help="A session.mcap: the layout then shows its nodes.",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Print a layout with which Foxglove or PlotJuggler shows a recording.

    Of many nodes it shows those that failed and those that used the most CPU time.
    """
    from play_launch.cli.layout import show_layout  # noqa: PLC0415 - as above

    raise typer.Exit(show_layout(tool, file))
