"""Upkeep of earlier sessions while a system runs."""

from __future__ import annotations

import asyncio
import logging
import os
from typing import TYPE_CHECKING

import pytest

from play_launch.config.model import KeepConfig
from play_launch.container.ros import spawn_guard
from play_launch.postmortem.upkeep import look_after_sessions
from play_launch.supervisor.view import SystemView
from tests.postmortem.archive.scenes import begin_session, cut_off_session, name_of, past_session

if TYPE_CHECKING:
    from pathlib import Path

pytestmark = pytest.mark.anyio


async def test_what_was_cut_off_is_completed_and_said_in_one_line(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    folder = cut_off_session(tmp_path, 1)
    _, writer = begin_session(tmp_path, 2)
    with caplog.at_level(logging.INFO, "play_launch.postmortem.upkeep"):
        await look_after_sessions(tmp_path, KeepConfig(), SystemView, spawn_guard(), rest=0)
    (line,) = caplog.records
    assert line.levelno == logging.WARNING
    assert line.getMessage().startswith("recovered the recording of 1 session")
    assert (folder / "session.mcap").exists()
    writer.close()


async def test_limits_are_kept_until_the_end(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    for day in (1, 2, 3):
        past_session(tmp_path, day)
    caplog.set_level(logging.INFO, "play_launch.postmortem.upkeep")
    said = asyncio.Event()

    class Said(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            said.set()

    handler = Said()
    logging.getLogger("play_launch.postmortem.upkeep").addHandler(handler)
    keep = KeepConfig(sessions=1)
    looking = asyncio.create_task(
        look_after_sessions(tmp_path, keep, SystemView, spawn_guard(), rest=0)
    )
    await said.wait()
    assert not looking.done(), "it goes on, as the running session grows"
    looking.cancel()
    await asyncio.gather(looking, return_exceptions=True)
    logging.getLogger("play_launch.postmortem.upkeep").removeHandler(handler)
    assert [path.name for path in tmp_path.iterdir()] == [name_of(3)]


async def test_its_end_is_not_waited_for(tmp_path: Path) -> None:
    # A pipe in place of a recording would be waited for by a program that opens it carelessly.
    folder = cut_off_session(tmp_path, 1, lines=20_000)
    os.mkfifo(folder / "session_1.mcap.active")
    looking = asyncio.create_task(
        look_after_sessions(tmp_path, KeepConfig(), SystemView, spawn_guard(), rest=0)
    )
    while not any(path.name.endswith("ing") for path in folder.iterdir()) and not looking.done():
        await asyncio.sleep(0)
    looking.cancel()
    await asyncio.gather(looking, return_exceptions=True)
    assert (folder / "session.mcap").exists() or (folder / "session.mcap.active").exists()
