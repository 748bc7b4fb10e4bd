"""The exit of a container is not published."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from play_launch.supervisor import difference
from tests.simulation.rewriting import rewrite

if TYPE_CHECKING:
    import pytest

FOUND_BY: Final = "every exit is reported once"


def apply(patch: pytest.MonkeyPatch) -> None:
    rewrite(
        patch,
        difference._process,
        "if new.exit is not None and (",
        "if new.container is None and new.exit is not None and (",
    )
