"""Upkeep of earlier sessions' recordings while a system runs, once it is up."""

from __future__ import annotations

import asyncio
import logging
import os
import signal
import sys
from typing import TYPE_CHECKING, Final

from play_launch.process.child import spawn
from play_launch.process.guard import SessionGuard, SpawnError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from play_launch.config.model import KeepConfig
    from play_launch.process.lines import Line
    from play_launch.supervisor.events import Stream
    from play_launch.supervisor.view import SystemView

_TIMEOUT: Final = 60.0
"""Seconds after which a system that is not complete counts as one that never will be."""
_LOOK: Final = 1.0
REST = 10.0
"""Seconds between the end of the bring-up and the first look at other sessions."""
_AGAIN: Final = 600.0
"""Seconds until limits are kept again: the running session grows, too."""
_log = logging.getLogger(__name__)


async def look_after_sessions(
    log_folder: Path,
    keep: KeepConfig,
    view: Callable[[], SystemView],
    guard: Path,
    *,
    rest: float | None = None,
) -> None:
    """Recover what was cut off, and keep to the limits; until cancelled.

    It is done by a process at the lowest priority, which ends when this is cancelled; the program
    ``guard`` ties it to this one. It begins ``rest`` seconds (None: `REST`) after the bring-up.
    """
    await _end_of_bring_up(view)
    await asyncio.sleep(REST if rest is None else rest)
    while True:
        await _run_once(log_folder, keep, guard)
        if keep.sessions is None and keep.size is None:
            return
        await asyncio.sleep(_AGAIN)


async def _end_of_bring_up(view: Callable[[], SystemView]) -> None:
    loop = asyncio.get_running_loop()
    latest = loop.time() + _TIMEOUT
    while not view().is_complete and loop.time() < latest:  # noqa: ASYNC110 - views have no event
        await asyncio.sleep(_LOOK)


async def _run_once(log_folder: Path, keep: KeepConfig, guard: Path) -> None:
    # The working directory is no place for modules.
    command = [sys.executable, "-P", "-m", "play_launch.postmortem.archive", os.fspath(log_folder)]
    if keep.sessions is not None:
        command.append(f"--keep-sessions={keep.sessions}")
    if keep.size is not None:
        command.append(f"--keep-size={keep.size}")
    try:
        parent = SessionGuard.start(guard)
    except OSError as error:
        _log.warning("upkeep of earlier sessions failed: %s", error)
        return
    try:
        child = await spawn(command, env=os.environ, guard=parent, on_output=_report)
        try:
            await child.gone()
        except asyncio.CancelledError:
            # The next start takes up what it was at.
            child.send_signal(signal.SIGKILL)
            await child.gone()
            raise
    except SpawnError as error:
        _log.warning("upkeep of earlier sessions failed: %s", error)
    finally:
        await parent.end()


def _report(_stream: Stream, lines: Sequence[Line]) -> None:
    for line in lines:
        level, _, text = line.text.partition(": ")
        if level == "info":
            _log.info("%s", text)
        else:
            _log.warning("%s", text if level == "warning" else line.text)
