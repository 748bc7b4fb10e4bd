"""``play-launch layout``: how another tool shows a recording."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Literal

import typer

from play_launch import ExitCode
from play_launch.cli import options
from play_launch.cli.info import report_damage
from play_launch.cli.output import say
from play_launch.postmortem.export.layouts import (
    Subjects,
    chosen,
    foxglove_layout,
    plotjuggler_layout,
)
from play_launch.postmortem.timeline import read_timeline

Tool = Literal["foxglove", "plotjuggler"]


def layout(
    tool: Annotated[Tool, typer.Argument(metavar="TOOL", show_default=False)],
    file: Annotated[
        Path | None,
        options.argument("[FILE]", "A session.mcap: the layout then shows its nodes."),
    ] = None,
) -> int:
    """Print a layout with which Foxglove or PlotJuggler shows a recording.

    TOOL is foxglove or plotjuggler. Of many nodes the layout shows those that failed and those that
    used the most CPU time.
    """
    subjects, code = Subjects(), 0
    if file is not None:
        timeline = read_timeline(file)
        subjects = chosen(timeline)
        code = ExitCode.DAMAGED if report_damage(timeline.session.reader) else 0
    if tool == "foxglove":
        say(json.dumps(foxglove_layout(subjects), indent=2))
    else:
        say(plotjuggler_layout(subjects).rstrip("\n"))
    return code
