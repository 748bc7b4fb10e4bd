"""Log folders with sessions in them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from play_launch.config.model import RotateConfig
from play_launch.container.cdr.messages import log_message
from play_launch.recording.bag import BagWriter
from play_launch.recording.topics import OUTPUT

if TYPE_CHECKING:
    from pathlib import Path


def name_of(day: int) -> str:
    return f"2026-11-{day:02}-06-36-25-demo"


def begin_session(
    log_folder: Path, day: int, lines: int = 10, *, parts: int = 1
) -> tuple[Path, BagWriter]:
    """A session that is being recorded: so many lines in so many files, all of them flushed."""
    folder = log_folder / name_of(day)
    folder.mkdir(parents=True)
    writer = BagWriter(
        folder / "session.mcap", rotation=RotateConfig(size=1 if parts > 1 else 1e9), has_index=True
    )
    writer.metadata("play_launch.session", {"id": str(day)})
    channel = writer.register(OUTPUT)
    for part in range(parts):
        for number in range(lines):
            data = log_message(number, 20, "/a", f"{part} {number}", file="stdout")
            writer.write(channel, data, log_time=number + 1, publish_time=number)
        if part < parts - 1:
            writer.flush()
    return folder, writer


def past_session(log_folder: Path, day: int, lines: int = 10, *, parts: int = 1) -> Path:
    """One that ended in order."""
    folder, writer = begin_session(log_folder, day, lines, parts=parts)
    writer.close()
    return folder


def cut_off_session(log_folder: Path, day: int, lines: int = 10, *, parts: int = 1) -> Path:
    """One whose supervisor was killed: nothing is said at the end, and no lock is held."""
    folder, writer = begin_session(log_folder, day, lines, parts=parts)
    writer.flush() if parts == 1 else None
    writer.abandon()
    return folder
