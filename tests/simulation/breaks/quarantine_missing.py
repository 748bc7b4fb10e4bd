"""A node that kills its container is loaded again and again."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from play_launch.supervisor import process_rules
from tests.simulation.rewriting import rewrite

if TYPE_CHECKING:
    import pytest

FOUND_BY: Final = "what kills its container is not loaded again"


def apply(patch: pytest.MonkeyPatch) -> None:
    rewrite(
        patch, process_rules._restart, "quarantine.begin(step, process, blamed, reason)", "pass"
    )
