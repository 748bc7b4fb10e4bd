"""A load that the container does not know is sent again and again."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from play_launch.supervisor import node_rules
from tests.simulation.rewriting import rewrite

if TYPE_CHECKING:
    import pytest

FOUND_BY: Final = "a lost load is sent again once"


def apply(patch: pytest.MonkeyPatch) -> None:
    rewrite(patch, node_rules._apply, "fact is NodeFact.STATUS_UNKNOWN and before.resent", "False")
