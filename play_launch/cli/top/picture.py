"""A picture of the screen, for which no terminal is needed."""

from __future__ import annotations

import asyncio
import re
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Final

from play_launch.cli.top.app import End, TopApp
from play_launch.cli.top.cells import clean
from play_launch.control.protocol import Code, ControlError
from play_launch.postmortem.whole_file import is_standard_output

if TYPE_CHECKING:
    from textual.pilot import Pilot

    from play_launch.control.client import ControlClient

_FONT_FACE: Final = re.compile(r" *@font-face \{[^}]*\}\n")
_MOST_WAIT: Final = 10.0
"""Seconds for the session to answer."""
_FOR_SAMPLES: Final = 3.0
"""Seconds for CPU and memory to be known; they may never be."""


def write_picture(client: ControlClient, file: str, size: tuple[int, int]) -> int:
    """Write the screen as SVG as soon as it shows something; return the exit code.

    Raises:
        ControlError: When the session does not answer, or the file cannot be written.
    """
    app = TopApp(client)
    pictures: list[str] = []

    async def look(pilot: Pilot[object]) -> None:
        began = time.monotonic()
        while not _is_complete(app, time.monotonic() - began):
            await pilot.pause(0.1)
        if app.model.has_rows:
            await pilot.pause(0.2)
            picture = app.export_screenshot(title=f"play-launch top: {clean(client.hello.name)}")
            pictures.append(without_network(picture))
        app.exit(End())

    asyncio.run(app.run_async(headless=True, size=size, auto_pilot=look))
    if not pictures:
        raise ControlError(Code.TIMEOUT, f"{client.hello.name} does not answer")
    try:
        if is_standard_output(Path(file)):
            sys.stdout.write(pictures[0])
        else:
            Path(file).write_text(pictures[0], encoding="utf-8")
    except OSError as error:
        raise ControlError(Code.FAILED, f"cannot write {file}: {error.strerror}") from None
    return 0


def without_network(picture: str) -> str:
    """Let an SVG of rich use the reader's own font instead of one that is fetched."""
    return _FONT_FACE.sub("", picture).replace("Fira Code, monospace", "monospace")


def _is_complete(app: TopApp, seconds: float) -> bool:
    if not app.model.has_rows:
        return seconds > _MOST_WAIT
    has_samples = any(row.cpu_percent is not None for row in app.model.rows)
    return seconds > _FOR_SAMPLES or (has_samples and len(app.model.buffer) > 0)
