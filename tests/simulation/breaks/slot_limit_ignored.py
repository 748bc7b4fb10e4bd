"""One container more than allowed starts at a time."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from play_launch.supervisor import process_rules
from tests.simulation.rewriting import rewrite

if TYPE_CHECKING:
    import pytest

FOUND_BY: Final = "no more containers start at once than may"


def apply(patch: pytest.MonkeyPatch) -> None:
    rewrite(patch, process_rules._has_slot, "< step.world.starts", "<= step.world.starts")
