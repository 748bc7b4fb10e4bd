"""A process that is replaced keeps its configuration."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from play_launch.supervisor import process_rules
from tests.simulation.rewriting import rewrite

if TYPE_CHECKING:
    import pytest

FOUND_BY: Final = "the configuration holds"


def apply(patch: pytest.MonkeyPatch) -> None:
    rewrite(
        patch,
        process_rules._with_next_config,
        "Process(config=config,",
        "Process(config=process.config,",
    )
