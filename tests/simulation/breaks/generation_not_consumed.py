"""A start does not fulfil the request for it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from play_launch.supervisor import process_rules
from tests.simulation.rewriting import rewrite

if TYPE_CHECKING:
    import pytest

FOUND_BY: Final = "restart bounds hold"


def apply(patch: pytest.MonkeyPatch) -> None:
    rewrite(patch, process_rules._begin, "attempted=process.generation,", "")
