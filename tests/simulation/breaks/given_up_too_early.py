"""One restart less than allowed."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from play_launch.supervisor import restart
from tests.simulation.rewriting import rewrite

if TYPE_CHECKING:
    import pytest

FOUND_BY: Final = "restart bounds hold"


def apply(patch: pytest.MonkeyPatch) -> None:
    rewrite(
        patch,
        restart.decide,
        "len(recent) >= bounds.max_restarts and",
        "len(recent) + 1 >= bounds.max_restarts and",
    )
