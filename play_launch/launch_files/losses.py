"""What could not be carried over, collected."""

from __future__ import annotations

from typing import TYPE_CHECKING

from play_launch.launch_files.records import Loss

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator


class Losses:
    """What could not be carried over, in the order in which it was found, each once."""

    def __init__(self, found: Iterable[Loss] = ()) -> None:
        self._found: dict[Loss, None] = dict.fromkeys(found)

    def __iter__(self) -> Iterator[Loss]:
        return iter(self._found)

    def lost(self, where: str, what: str) -> None:
        """Report something that is missing."""
        self._found[Loss(where, what)] = None

    def note(self, where: str, what: str) -> None:
        """Report something that is worth knowing."""
        self._found[Loss(where, what, is_note=True)] = None

    @property
    def count(self) -> int:
        """How much is missing; notes are not counted."""
        return sum(not loss.is_note for loss in self._found)
