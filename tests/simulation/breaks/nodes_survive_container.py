"""The nodes of a container that exited stay loaded."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, cast

from play_launch.supervisor.process_life import TABLE, Cell, Fact
from play_launch.supervisor.world import Phase

if TYPE_CHECKING:
    import pytest

FOUND_BY: Final = "events tell the truth"


def apply(patch: pytest.MonkeyPatch) -> None:
    patch.setitem(cast("Any", TABLE[Phase.RUNNING]), Fact.EXITED_RESTART, Cell(Phase.BACKOFF))
