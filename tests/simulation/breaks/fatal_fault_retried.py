"""A container that speaks another version is started again."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from play_launch.supervisor import process_rules
from tests.simulation.rewriting import rewrite

if TYPE_CHECKING:
    import pytest

FOUND_BY: Final = "what cannot succeed is not tried again"


def apply(patch: pytest.MonkeyPatch) -> None:
    rewrite(patch, process_rules._exit, "process.is_fatal or was_stopped", "was_stopped")
