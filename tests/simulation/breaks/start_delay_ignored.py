"""A start does not wait for its delay."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from play_launch.supervisor import conditions
from tests.simulation.rewriting import rewrite

if TYPE_CHECKING:
    import pytest

FOUND_BY: Final = "nothing starts before its conditions hold"


def apply(patch: pytest.MonkeyPatch) -> None:
    rewrite(patch, conditions.readiness, "if now >= met_since + rule.delay", "if now >= met_since")
