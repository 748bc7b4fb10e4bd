"""What is missing does not show in the exit code."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from play_launch.supervisor import exit_code
from tests.simulation.rewriting import rewrite

if TYPE_CHECKING:
    import pytest

FOUND_BY: Final = "the exit code tells the truth"


def apply(patch: pytest.MonkeyPatch) -> None:
    rewrite(patch, exit_code.exit_code, "not expected.is_complete", "False")
