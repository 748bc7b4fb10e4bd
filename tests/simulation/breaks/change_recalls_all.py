"""A change starts what an operator stopped while it was carried out."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from play_launch.supervisor import change
from tests.simulation.rewriting import rewrite

if TYPE_CHECKING:
    import pytest

FOUND_BY: Final = "what is stopped stays stopped"


def apply(patch: pytest.MonkeyPatch) -> None:
    rewrite(patch, change.dismissed, "world.change.recalls - {name}", "world.change.recalls")
