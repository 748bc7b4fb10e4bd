"""A start does not wait until nothing is left of the last process."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from play_launch.supervisor import process_rules
from tests.simulation.rewriting import rewrite

if TYPE_CHECKING:
    import pytest

FOUND_BY: Final = "never two live attempts of a unit"


def apply(patch: pytest.MonkeyPatch) -> None:
    rewrite(patch, process_rules._queue, "not process.is_present and ", "")
