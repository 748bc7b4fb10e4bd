"""The unloading of a node is not published."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from play_launch.supervisor import difference
from tests.simulation.rewriting import rewrite

if TYPE_CHECKING:
    import pytest

FOUND_BY: Final = "events tell the truth"


def apply(patch: pytest.MonkeyPatch) -> None:
    rewrite(
        patch, difference._node, "not has_changed and not text", "new.state is NodeState.UNLOADED"
    )
