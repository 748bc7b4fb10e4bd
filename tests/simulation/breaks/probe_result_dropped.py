"""The result of a probe is dropped: its node stays in quarantine."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from play_launch.supervisor import quarantine
from tests.simulation.rewriting import rewrite

if TYPE_CHECKING:
    import pytest

FOUND_BY: Final = "what is wanted is up"


def apply(patch: pytest.MonkeyPatch) -> None:
    rewrite(
        patch,
        quarantine.probed,
        "if finding is None or finding.loads:\n        step.world.put(node, stage=Stage.CLEARED)",
        "if finding is None or finding.loads:\n        pass",
    )
