"""Types of options and arguments, each declared once for all commands."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Final, Literal, TypeAlias

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
    return _parsed("parse_positive_duration", text)


def duration_or_zero(text: Any) -> float:
    return _parsed("parse_duration", text)


def _parsed(parse: str, text: Any) -> float:
    from play_launch.config import values  # noqa: PLC0415 - slow

    try:
        return float(getattr(values, parse)(text))
    except ValueError as error:
        raise typer.BadParameter(str(error)) from None


def time(about: str, *names: str, default: str = "") -> Any:
    # typer would write "[default: (10s)]".
    text = f"{about} Default: {default}." if default else about
    return typer.Option(*names, parser=duration, metavar="TIME", help=text, show_default=False)


def argument(metavar: str, about: str, complete: str = "") -> Any:
    """Declare an argument, with the function of `cli.completion` that completes it."""
    return typer.Argument(
        metavar=metavar, help=about, show_default=False, autocompletion=completed_by(complete)
    )


def _latest_recording() -> Path:
    from play_launch.recording.session import LATEST, default_log_folder  # noqa: PLC0415

    latest = default_log_folder() / LATEST
    if not latest.exists():
        why = f"no session was recorded in {latest.parent}; name a session.mcap or its folder"
        raise typer.BadParameter(why)
    return latest.resolve()


def completed_by(function: str) -> Any:
    """Complete by a function of `cli.completion`; empty: not at all."""

    def complete(ctx: typer.Context, incomplete: str) -> Any:
        from play_launch.cli import completion  # noqa: PLC0415 - at Tab only

        return getattr(completion, function)(ctx, incomplete)

    return complete if function else None


def output(about: str, metavar: str = "FILE") -> Any:
    return typer.Option("--output", "-o", metavar=metavar, help=about, show_default=False)


Level: TypeAlias = Literal["debug", "info", "warn", "error", "fatal"]
LEVELS: Final = {"debug": 10, "info": 20, "warn": 30, "error": 40, "fatal": 50}
"""As in ``rcl_interfaces/Log``."""
_NAMES: Final = "full names, patterns such as '/sensing/*', or the last part of a name."

Json: TypeAlias = Annotated[bool, typer.Option("--json", help="Print JSON.")]
Session: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--session",
        metavar="SESSION",
        help="Folder, name or pid of the session, if several are running.",
        show_default=False,
        autocompletion=completed_by("sessions"),
    ),
]
Names: TypeAlias = Annotated[
    list[str] | None, argument("[NAME]...", f"Only these: {_NAMES}", "units")
]
Units: TypeAlias = Annotated[
    list[str], argument("NAME...", f"{_NAMES[0].upper()}{_NAMES[1:]}", "units")
]
Follow: TypeAlias = Annotated[
    bool, typer.Option("-f", "--follow", help="Continue with new ones, until Ctrl-C.")
]
Recording: TypeAlias = Annotated[
    Path,
    typer.Argument(
        metavar="[FILE]",
        help="A session.mcap, or the folder of a session. Default: the latest session in "
        "$PLAY_LAUNCH_LOG_DIR, else in play_launch of $ROS_LOG_DIR, $ROS_HOME or ~/.ros.",
        default_factory=_latest_recording,
        show_default=False,
    ),
]
ConfigFile: TypeAlias = Annotated[Path, argument("CONFIG", "The YAML file.")]
ConfigArguments: TypeAlias = Annotated[
    list[str] | None,
    argument("[NAME:=VALUE]...", "Arguments of the configuration, ${arg:NAME} in it."),
]
LogDir: TypeAlias = Annotated[
    Path | None,
    typer.Option(
        help="Where to make the folder of this session. Default: log_dir of the configuration, "
        "else $PLAY_LAUNCH_LOG_DIR, else play_launch in $ROS_LOG_DIR, $ROS_HOME or ~/.ros.",
        metavar="DIR",
        show_default=False,
    ),
]
Machine: TypeAlias = Annotated[
    str,
    typer.Option(
        "--machine",
        metavar="NAME",
        help="Only the part of this one of the machines in the configuration.",
        show_default=False,
    ),
]
Duration: TypeAlias = Annotated[
    float | None, time("Stop after this time: 30, 30s, 2min, 1h. Default: at Ctrl-C.")
]
Quiet: TypeAlias = Annotated[
    bool, typer.Option("--quiet", "-q", help="Do not show output of nodes; it is recorded.")
]
Output: TypeAlias = Annotated[Path | None, output("The file to write. Default: stdout.")]
OutputBeside: TypeAlias = Annotated[
    Path | None, output("The file to write. Default: beside the recording.")
]
Strict: TypeAlias = Annotated[
    bool,
    typer.Option("--strict", help="If anything cannot be converted, do nothing and exit with 2."),
]
LaunchFile: TypeAlias = Annotated[
    list[str],
    argument(
        "(PKG FILE | PATH) [NAME:=VALUE]...", "A launch file, and its arguments.", "launch_files"
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
    float, time("Limit for the evaluation of the launch file.", "--timeout", default="2min")
]
