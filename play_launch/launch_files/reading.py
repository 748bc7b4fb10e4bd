"""Text of files that launch files name: never waits for a writer, never reads without end."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from play_launch.config.source import Refused, read_bytes

LARGEST: Final = 16 * 2**20
"""Bytes of a launch file, of a parameter file, and of what else is read."""


class UnreadableError(Exception):
    """A file cannot be read; the text is the reason."""


def text_of(path: str) -> str:
    """Return what stands in a file.

    Raises:
        UnreadableError: When there is none, or it is no text.
    """
    content = read_bytes(Path(path), LARGEST)
    if isinstance(content, Refused):
        raise UnreadableError(content.message)
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise UnreadableError("is not UTF-8") from error
