"""A node is not unloaded."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from play_launch.supervisor import node_rules
from tests.simulation.rewriting import rewrite

if TYPE_CHECKING:
    import pytest

FOUND_BY: Final = "what is stopped stays stopped"


def apply(patch: pytest.MonkeyPatch) -> None:
    rewrite(
        patch,
        node_rules._execute,
        "step.effects.append(Unload(node.key.container, node.unique_id))",
        "pass",
    )
