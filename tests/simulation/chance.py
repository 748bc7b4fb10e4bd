"""Chance that stays the same for all else when one trouble is left out."""

from __future__ import annotations

from collections import Counter
from hashlib import blake2b
from typing import TYPE_CHECKING, Final, TypeVar

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

_T = TypeVar("_T")
_RANGE: Final = 2.0**64


class Chance:
    """Random numbers, each by what it is for, so that they do not depend on one another."""

    def __init__(self, seed: int, without: Collection[str] = ()) -> None:
        self.seed = seed
        self.troubles: list[str] = []
        """What went wrong, or was meddled with, so far."""
        self._without = frozenset(without)
        self._counts: Counter[str] = Counter()

    def _next(self, what: str) -> tuple[str, float]:
        self._counts[what] += 1
        name = f"{what} #{self._counts[what]}"
        digest = blake2b(f"{self.seed} {name}".encode(), digest_size=8).digest()
        return name, int.from_bytes(digest, "big") / _RANGE

    def number(self, what: str) -> float:
        """Give a number in [0, 1)."""
        return self._next(what)[1]

    def choice(self, options: Sequence[_T], what: str) -> _T:
        return options[int(self.number(what) * len(options))]

    def happens(self, likelihood: float, what: str) -> bool:
        """Whether a trouble happens; not if it is left out."""
        name, number = self._next(what)
        if number >= likelihood or name in self._without:
            return False
        self.troubles.append(name)
        return True
