"""A process that comes after its stop is left running."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, cast

from play_launch.supervisor.process_life import TABLE, Cell, Fact
from play_launch.supervisor.world import Phase

if TYPE_CHECKING:
    import pytest

FOUND_BY: Final = "what is stopped stays stopped"


def apply(patch: pytest.MonkeyPatch) -> None:
    patch.setitem(cast("Any", TABLE[Phase.STOPPING]), Fact.STARTED, Cell(Phase.STOPPING))
