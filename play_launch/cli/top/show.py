"""Runs the screen on a terminal, and gives the terminal back as it was."""

from __future__ import annotations

import asyncio
import os
import sys
from typing import TYPE_CHECKING

from play_launch.cli.show.terminal import wants_colour
from play_launch.cli.top.app import TopApp
from play_launch.cli.top.terminal import signals_to
from play_launch.control.protocol import Code, ControlError

if TYPE_CHECKING:
    from play_launch.cli.top.app import End
    from play_launch.control.client import ControlClient


def show(client: ControlClient) -> End:
    """Show the screen until there is a reason to leave it."""
    has_colours = wants_colour(sys.stdout)
    # Textual would replace colours by greys.
    os.environ.pop("NO_COLOR", None)
    return asyncio.run(_show(client, has_colours=has_colours))


async def _show(client: ControlClient, *, has_colours: bool) -> End:
    app = TopApp(client, has_colours=has_colours)
    with signals_to(app.end_by, app.give_back):
        # Without the mouse, a person can still mark text, in the terminal's own way.
        end = await app.run_async(mouse=False)
    if end is None:
        # Textual has written where.
        raise ControlError(Code.INTERNAL, "the screen failed, by a mistake of play-launch's own")
    return end
