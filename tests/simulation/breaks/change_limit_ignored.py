"""A step of a change may take as long as it likes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from play_launch.supervisor import change
from tests.simulation.rewriting import rewrite

if TYPE_CHECKING:
    import pytest

FOUND_BY: Final = "a change comes to its end"


def apply(patch: pytest.MonkeyPatch) -> None:
    rewrite(patch, change._result, "now >= each.began_at + change.limit", "False")
    rewrite(patch, change.next_deadline, "change is None", "True")
