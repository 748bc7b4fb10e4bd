"""What an operator stops is wanted all the same."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from play_launch.supervisor import world
from tests.simulation.rewriting import rewrite

if TYPE_CHECKING:
    import pytest

FOUND_BY: Final = "what is stopped stays stopped"


def apply(patch: pytest.MonkeyPatch) -> None:
    rewrite(patch, world.is_wanted, " and unit.name not in world.dismissed", "")
