"""Nodes are loaded into a container that is not ready."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from play_launch.supervisor import world
from tests.simulation.rewriting import rewrite

if TYPE_CHECKING:
    import pytest

FOUND_BY: Final = "nothing is loaded before the hello"


def apply(patch: pytest.MonkeyPatch) -> None:
    takes_loads = vars(world.Process)["takes_loads"].fget
    rewrite(
        patch,
        takes_loads,
        "self.phase is Phase.RUNNING",
        "self.phase in {Phase.STARTING, Phase.RUNNING}",
    )
