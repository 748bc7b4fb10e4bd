"""The end of a killed process is waited for without end."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from play_launch.supervisor import process_rules
from tests.simulation.rewriting import rewrite

if TYPE_CHECKING:
    import pytest

FOUND_BY: Final = "what does not die is given up"


def apply(patch: pytest.MonkeyPatch) -> None:
    rewrite(patch, process_rules._kill, "due=due", "due=None")
