"""on_exit: shutdown does nothing."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from play_launch.supervisor import process_rules
from tests.simulation.rewriting import rewrite

if TYPE_CHECKING:
    import pytest

FOUND_BY: Final = "an end with consequences ends all"


def apply(patch: pytest.MonkeyPatch) -> None:
    rewrite(patch, process_rules._end_all_with, "is OnExit.SHUTDOWN", "is None")
