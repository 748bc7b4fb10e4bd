"""A node is loaded whatever it depends on."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from play_launch.supervisor import node_rules
from tests.simulation.rewriting import rewrite

if TYPE_CHECKING:
    import pytest

FOUND_BY: Final = "nothing starts before its conditions hold"


def apply(patch: pytest.MonkeyPatch) -> None:
    rewrite(patch, node_rules._load_with_container, "if not ready.may_start:", "if False:")
