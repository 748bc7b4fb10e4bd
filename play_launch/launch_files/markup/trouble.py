"""Why a launch file cannot be evaluated."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from play_launch.launch_files.records import Place


class Trouble(Exception):  # noqa: N818 - it becomes a Failure
    """Something is wrong; `place` is None until it is known."""

    def __init__(self, message: str, place: Place | None = None) -> None:
        super().__init__(message)
        self.place = place


class Exceeded(Trouble):
    """A launch file takes more than it may; nothing after it is looked at."""
