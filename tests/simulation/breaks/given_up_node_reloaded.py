"""A node that was given up is loaded with its container."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from play_launch.supervisor import node_rules
from tests.simulation.rewriting import rewrite

if TYPE_CHECKING:
    import pytest

FOUND_BY: Final = "what gave up stays so"


def apply(patch: pytest.MonkeyPatch) -> None:
    rewrite(patch, node_rules.settle, " - {NodeState.GAVE_UP}", "")
