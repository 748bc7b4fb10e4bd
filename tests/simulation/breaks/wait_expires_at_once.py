"""A condition is waited for no longer than a moment."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from play_launch.supervisor import conditions
from tests.simulation.rewriting import rewrite

if TYPE_CHECKING:
    import pytest

FOUND_BY: Final = "nothing starts before its conditions hold"


def apply(patch: pytest.MonkeyPatch) -> None:
    rewrite(patch, conditions._deadline, "since + dependency.timeout", "since")
