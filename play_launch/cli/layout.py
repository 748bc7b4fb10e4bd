"""``play-launch layout``: how another tool shows a recording."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Final

from play_launch.cli.info import DAMAGED, report_damage
from play_launch.cli.output import fail, say
from play_launch.postmortem.bag_reader import NotARecordingError
from play_launch.postmortem.export.foxglove import foxglove_layout
from play_launch.postmortem.export.plotjuggler import plotjuggler_layout
from play_launch.postmortem.export.subjects import NO_SUBJECT, chosen
from play_launch.postmortem.session import PastSession

if TYPE_CHECKING:
    from pathlib import Path

TOOLS: Final = ("foxglove", "plotjuggler")


def show_layout(tool: str, file: Path | None) -> int:
    """Print a layout; with a recording, one for its nodes; return the exit code."""
    if tool not in TOOLS:
        fail(f"there is no layout for {tool}: use {' or '.join(TOOLS)}")
    subjects, code = NO_SUBJECT, 0
    if file is not None:
        session = PastSession(file)
        try:
            subjects = chosen(session)
        except NotARecordingError as error:
            fail(str(error))
        code = DAMAGED if report_damage(session.reader) else 0
    if tool == "foxglove":
        say(json.dumps(foxglove_layout(subjects), indent=2))
    else:
        say(plotjuggler_layout(subjects).rstrip("\n"))
    return code
