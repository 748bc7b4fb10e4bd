"""Loads that were abandoned for their silence, and the nodes that come of them all the same."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from play_launch.runtime.stock.composition_words import Action, Remark, SendUnload, Wanted

if TYPE_CHECKING:
    from collections.abc import Container

_LIMIT: Final = 1000
"""Attempts whose late answers are still understood."""


@dataclass(slots=True)
class AbandonedLoads:
    """Attempts without an end, and by unique_id what they left in the container.

    Such a node is first kept for the next load of the same declaration; one that nobody needs is
    unloaded, again and again until it is not listed any more.
    """

    _attempts: dict[int, Wanted] = field(default_factory=dict)
    _kept: dict[int, Wanted] = field(default_factory=dict)
    _leaving: dict[int, int | None] = field(default_factory=dict)
    """With the first list that may count; None while UnloadNode is open."""

    def abandon(self, attempt: int, wanted: Wanted) -> None:
        """Stop waiting for an attempt; its answer may still come."""
        self._attempts[attempt] = wanted
        while len(self._attempts) > _LIMIT:
            del self._attempts[next(iter(self._attempts))]

    def answered(self, attempt: int) -> Wanted | None:
        """Take the attempt whose answer came after all; None when it is not one of these."""
        return self._attempts.pop(attempt, None)

    def keep(self, unique_id: int, wanted: Wanted) -> None:
        """Remember a node that came late."""
        self._kept[unique_id] = wanted

    def find(self, wanted: Wanted) -> list[int]:
        """The nodes that may be taken for a load."""
        return [unique_id for unique_id, of in self._kept.items() if of == wanted]

    def is_kept(self, unique_id: int) -> bool:
        """Whether a node waits for the next load."""
        return unique_id in self._kept

    def is_leaving(self, unique_id: int) -> bool:
        """Whether a node is being unloaded because nobody needs it."""
        return unique_id in self._leaving

    def take(self, unique_id: int) -> None:
        """Forget a kept node: it belongs to a load now, or it is gone."""
        self._kept.pop(unique_id, None)

    def clear(self, wanted: Wanted) -> list[Action]:
        """Unload what is left, since the load has what it wanted, or failed."""
        actions: list[Action] = []
        for unique_id in self.find(wanted):
            del self._kept[unique_id]
            self._leaving[unique_id] = None
            actions += [
                Remark(f"node {unique_id} came from an abandoned load; it is unloaded"),
                SendUnload(unique_id),
            ]
        return actions

    def unload_answered(self, unique_id: int, *, success: bool, list_from: int) -> None:
        """UnloadNode was answered, or nobody answered it: then a list from ``list_from`` on counts.

        It is sent again when such a list comes and not at once: it may be refused every time.
        """
        if success:
            del self._leaving[unique_id]
        else:
            self._leaving[unique_id] = list_from

    def listed(self, serial: int, unique_ids: Container[int]) -> list[SendUnload]:
        """Unload once more what is still there after an unload that failed or was lost."""
        actions: list[SendUnload] = []
        for unique_id, list_from in list(self._leaving.items()):
            if list_from is None or serial < list_from:
                continue
            if unique_id in unique_ids:
                self._leaving[unique_id] = None
                actions.append(SendUnload(unique_id))
            else:
                del self._leaving[unique_id]
        return actions
