"""A step of a change that is over stays open."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from play_launch.supervisor import change
from tests.simulation.rewriting import rewrite

if TYPE_CHECKING:
    import pytest

FOUND_BY: Final = "a step of a change ends once"


def apply(patch: pytest.MonkeyPatch) -> None:
    rewrite(patch, change._judge, "len(still_open) != len(change.open)", "False")
