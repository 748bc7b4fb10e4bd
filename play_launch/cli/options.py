"""Types of options and arguments, each declared once for all commands."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Final, TypeAlias

import typer

PLAIN: Final[dict[str, Any]] = {
    # Plain help: it is wrapped to the terminal's width, and comes up twice as fast.
    "rich_markup_mode": None,
    "add_completion": False,
    "pretty_exceptions_enable": False,
    "context_settings": {"help_option_names": ["-h", "--help"]},
}
"""How each `typer.Typer` is made."""


def duration(text: Any) -> float:
    """Read a duration of more than 0 s: ``30``, ``30s``, ``2min``, ``1h``."""
    from play_launch.config.values import parse_positive_duration  # noqa: PLC0415 - slow

    try:
        return parse_positive_duration(text)
    except ValueError as error:
        raise typer.BadParameter(str(error)) from None


def duration_or_zero(text: Any) -> float:
    """Read a duration, 0 s included."""
    from play_launch.config.values import parse_duration  # noqa: PLC0415 - slow

    try:
        return parse_duration(text)
    except ValueError as error:
        raise typer.BadParameter(str(error)) from None


def timeout(about: str, default: str) -> Any:
    """Declare ``--timeout``."""
    return typer.Option(
        "--timeout", parser=duration, metavar="TIME", help=about, show_default=default
    )


def complete_units(ctx: typer.Context, incomplete: str) -> Any:
    """Complete names of containers, nodes and processes of running sessions."""
    from play_launch.cli.completion import units  # noqa: PLC0415 - at Tab only

    return units(ctx, incomplete)


def complete_sessions(incomplete: str) -> Any:
    """Complete names and pids of running sessions."""
    from play_launch.cli.completion import sessions  # noqa: PLC0415 - at Tab only

    return sessions(incomplete)


def complete_launch_file(ctx: typer.Context, incomplete: str) -> Any:
    """Complete packages and their launch files."""
    from play_launch.cli.completion import launch_files  # noqa: PLC0415 - at Tab only

    return launch_files(ctx, incomplete)


Json: TypeAlias = Annotated[bool, typer.Option("--json", help="Print JSON.")]
Session: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--session",
        metavar="SESSION",
        help="Folder, name or pid of the session, if several are running.",
        show_default=False,
        autocompletion=complete_sessions,
    ),
]
Names: TypeAlias = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="[NAME]...",
        help="Only these: full names, patterns such as '/sensing/*', or the last part of a name.",
        show_default=False,
        autocompletion=complete_units,
    ),
]
Units: TypeAlias = Annotated[
    list[str],
    typer.Argument(
        metavar="NAME...",
        help="Full names, patterns such as '/sensing/*', or the last part of a name.",
        show_default=False,
        autocompletion=complete_units,
    ),
]
Follow: TypeAlias = Annotated[
    bool, typer.Option("-f", "--follow", help="Continue with new ones, until Ctrl-C.")
]
Recording: TypeAlias = Annotated[
    Path,
    typer.Argument(
        metavar="FILE", help="A session.mcap, or the folder of a session.", show_default=False
    ),
]
ConfigFile: TypeAlias = Annotated[
    Path, typer.Argument(metavar="CONFIG", help="The YAML file.", show_default=False)
]
ConfigArguments: TypeAlias = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="[NAME:=VALUE]...",
        help="Arguments of the configuration, ${arg:NAME} in it.",
        show_default=False,
    ),
]
LogDir: TypeAlias = Annotated[
    Path | None,
    typer.Option(
        help="Where to make the folder of this session. Default: log_dir of the configuration, "
        "else $PLAY_LAUNCH_LOG_DIR, $ROS_LOG_DIR/play_launch, ~/.ros/play_launch.",
        metavar="DIR",
        show_default=False,
    ),
]
Duration: TypeAlias = Annotated[
    float | None,
    typer.Option(
        parser=duration,
        help="Stop after this time: 30, 30s, 2min, 1h. Default: at Ctrl-C.",
        metavar="TIME",
        show_default=False,
    ),
]
Quiet: TypeAlias = Annotated[
    bool, typer.Option("--quiet", "-q", help="Do not show output of nodes; it is recorded.")
]
Output: TypeAlias = Annotated[
    Path | None,
    typer.Option(
        "--output",
        "-o",
        metavar="FILE",
        help="The file to write. Default: stdout.",
        show_default=False,
    ),
]
OutputBeside: TypeAlias = Annotated[
    Path | None,
    typer.Option(
        "--output",
        "-o",
        metavar="FILE",
        help="The file to write. Default: beside the recording.",
        show_default=False,
    ),
]
Strict: TypeAlias = Annotated[
    bool,
    typer.Option("--strict", help="If anything cannot be converted, do nothing and exit with 2."),
]
LaunchFile: TypeAlias = Annotated[
    list[str],
    typer.Argument(
        metavar="(PKG FILE | PATH) [NAME:=VALUE]...",
        help="A launch file, and its arguments.",
        show_default=False,
        autocompletion=complete_launch_file,
    ),
]
ShowArgs: TypeAlias = Annotated[
    bool, typer.Option("--show-args", "-s", help="Print the arguments of the launch file.")
]
LaunchPrefix: TypeAlias = Annotated[
    str,
    typer.Option(
        "--launch-prefix",
        metavar="COMMAND",
        help='A command in front of that of each process, such as "gdb -ex run --args".',
        show_default=False,
    ),
]
LaunchPrefixFilter: TypeAlias = Annotated[
    str,
    typer.Option(
        "--launch-prefix-filter",
        metavar="REGEX",
        help="Use --launch-prefix only for programs whose names start with this.",
        show_default=False,
    ),
]
ShowAllOutput: TypeAlias = Annotated[
    bool,
    typer.Option(
        "--show-all-subprocesses-output",
        "-a",
        help="Show output of all processes, also where the launch file only logs it.",
    ),
]
EvaluationTimeout: TypeAlias = Annotated[
    float,
    typer.Option(
        "--timeout",
        parser=duration,
        metavar="TIME",
        help="Limit for the evaluation of the launch file.",
        show_default="2min",
    ),
]
