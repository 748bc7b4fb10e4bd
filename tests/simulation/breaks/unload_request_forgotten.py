"""A request to unload is not noted."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from play_launch.supervisor import reducer
from tests.simulation.rewriting import rewrite

if TYPE_CHECKING:
    import pytest

FOUND_BY: Final = "what is stopped stays stopped"


def apply(patch: pytest.MonkeyPatch) -> None:
    rewrite(patch, reducer._operate_node, "world.dismissed |= {str(said.node)}", "pass")
