"""A process starts whatever it depends on."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from play_launch.supervisor import process_rules
from tests.simulation.rewriting import rewrite

if TYPE_CHECKING:
    import pytest

FOUND_BY: Final = "nothing starts before its conditions hold"


def apply(patch: pytest.MonkeyPatch) -> None:
    rewrite(patch, process_rules._queue, "if not ready.may_start:", "if False:")
