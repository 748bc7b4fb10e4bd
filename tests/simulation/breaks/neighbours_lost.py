"""The death of a container takes the nodes of others along."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from play_launch.supervisor import node_rules
from tests.simulation.rewriting import rewrite

if TYPE_CHECKING:
    import pytest

FOUND_BY: Final = "no unit's failure changes another unit"


def apply(patch: pytest.MonkeyPatch) -> None:
    rewrite(
        patch,
        node_rules.container_lost,
        "step.world.nodes_of(container.name)",
        "list(step.world.nodes.values())",
    )
