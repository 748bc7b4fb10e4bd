"""When a run goes before what it starts and stops, see docs/decisions/running-ahead.md."""

from __future__ import annotations

import asyncio
import contextlib
from typing import TYPE_CHECKING, Final

from play_launch.process.time_slice import run_ahead, run_along
from play_launch.supervisor.view import is_up

if TYPE_CHECKING:
    from play_launch.runtime.publisher import Publisher, StopRequests

LATEST: Final = 30.0
"""Seconds after which it runs along even though nodes are still being loaded."""
_LOOK: Final = 1.0
"""Seconds from one look for the end of the start, and for threads of our own, to the next."""


async def run_ahead_of(publisher: Publisher, stop: StopRequests) -> None:
    """Run before what starts, and before what ends, so that both are seen when they happen.

    In between the nodes go on undisturbed: importing ROS for a parameter that is set takes half a
    second, and messages of others were 50 ms late while that ran ahead.
    """
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(LATEST):
            while run_ahead() and not stop.requested.is_set():
                with contextlib.suppress(TimeoutError):
                    await asyncio.wait_for(stop.requested.wait(), _LOOK)
                if is_up(publisher.view):
                    break
    run_along()
    await stop.requested.wait()
    run_ahead()
