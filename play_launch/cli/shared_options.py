"""Options and arguments that several verbs take, each declared once for typer."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, TypeAlias

import typer

from play_launch.launch_files.configuration.options import (
    Containers,
)

ConfigFile: TypeAlias = Annotated[
    Path, typer.Argument(metavar="CONFIG", help="The YAML file.", show_default=False)
]
ConfigArguments: TypeAlias = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="[NAME:=VALUE]...",
        help="Arguments of the configuration, which are ${arg:NAME} in there.",
        show_default=False,
    ),
]
LogDir: TypeAlias = Annotated[
    Path | None,
    typer.Option(
        help="Where to make the folder of this session; by default what the configuration says, "
        "else $PLAY_LAUNCH_LOG_DIR, else $ROS_LOG_DIR/play_launch, else ~/.ros/play_launch.",
        metavar="DIR",
        show_default=False,
    ),
]
Duration: TypeAlias = Annotated[
    str | None,
    typer.Option(
        help="Stop after this time: 10s, 2min, 1h. Without it the system runs until Ctrl-C.",
        metavar="TIME",
        show_default=False,
    ),
]
Quiet: TypeAlias = Annotated[
    bool, typer.Option("--quiet", "-q", help="Do not show what nodes print; it is recorded.")
]
EventsAsJson: TypeAlias = Annotated[
    bool, typer.Option("--json", help="Show events as JSON, one object a line, for programs.")
]
Output: TypeAlias = Annotated[
    Path | None,
    typer.Option(
        "--output",
        "-o",
        metavar="CONFIG",
        help="Where to write the configuration; by default to stdout.",
        show_default=False,
    ),
]
ConfigurationAsJson: TypeAlias = Annotated[
    bool, typer.Option("--json", help="One JSON object on stdout, the configuration in it.")
]
Strict: TypeAlias = Annotated[
    bool,
    typer.Option(
        "--strict", help="Write and start nothing, and exit with 2, if anything gets lost."
    ),
]
LaunchFile: TypeAlias = Annotated[
    list[str],
    typer.Argument(
        metavar="(PKG FILE | PATH) [NAME:=VALUE]...",
        help="A launch file, and its arguments.",
        show_default=False,
    ),
]
ContainerType: TypeAlias = Annotated[
    Containers,
    typer.Option(
        "--container-type",
        help="Of the containers of rclcpp_components: isolated gives each node a process of its "
        "own, stock keeps their programs, same takes ours that do the same.",
    ),
]
ShowArgs: TypeAlias = Annotated[
    bool, typer.Option("--show-args", "-s", help="Print which arguments it takes.")
]
LaunchPrefix: TypeAlias = Annotated[
    str,
    typer.Option(
        "--launch-prefix",
        metavar="COMMAND",
        help='Put a command before those of all processes, such as "gdb -ex run --args".',
        show_default=False,
    ),
]
LaunchPrefixFilter: TypeAlias = Annotated[
    str,
    typer.Option(
        "--launch-prefix-filter",
        metavar="REGEX",
        help="Of --launch-prefix: only for programs whose names begin with this.",
        show_default=False,
    ),
]
ShowAllOutput: TypeAlias = Annotated[
    bool,
    typer.Option(
        "--show-all-subprocesses-output",
        "-a",
        help="Show what all processes print, also those whose output the launch file only logs.",
    ),
]
EvaluationTimeout: TypeAlias = Annotated[
    str,
    typer.Option(
        "--timeout", metavar="TIME", help="How long the launch file may take to be evaluated."
    ),
]
