"""A restart does not wait."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from play_launch.supervisor import process_rules
from tests.simulation.rewriting import rewrite

if TYPE_CHECKING:
    import pytest

FOUND_BY: Final = "restarts wait for their pause"


def apply(patch: pytest.MonkeyPatch) -> None:
    rewrite(patch, process_rules._restart, "text, due, outcome", "text, step.now, outcome")
