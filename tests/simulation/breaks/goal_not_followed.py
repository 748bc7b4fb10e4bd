"""A managed node is not talked to."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from play_launch.supervisor import goal_rules
from tests.simulation.rewriting import rewrite

if TYPE_CHECKING:
    import pytest

FOUND_BY: Final = "a managed node follows its unit"


def apply(patch: pytest.MonkeyPatch) -> None:
    rewrite(patch, goal_rules.settle, "goal.instance == instance and not is_new", "True")
