"""Starts go on while the system stops."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from play_launch.supervisor import world
from tests.simulation.rewriting import rewrite

if TYPE_CHECKING:
    import pytest

FOUND_BY: Final = "nothing starts while the system stops"


def apply(patch: pytest.MonkeyPatch) -> None:
    rewrite(patch, world.is_wanted, "not world.is_stopping and ", "")
