"""All stop at once."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from play_launch.supervisor import process_rules
from tests.simulation.rewriting import rewrite

if TYPE_CHECKING:
    import pytest

FOUND_BY: Final = "stops in reverse order"


def apply(patch: pytest.MonkeyPatch) -> None:
    rewrite(patch, process_rules._may_stop, "not world.is_stopping or world.is_hurried", "True")
