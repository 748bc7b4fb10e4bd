"""Reports of an old process count."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from play_launch.supervisor import reducer
from tests.simulation.rewriting import rewrite

if TYPE_CHECKING:
    import pytest

FOUND_BY: Final = "events of an old attempt change nothing"


def apply(patch: pytest.MonkeyPatch) -> None:
    rewrite(patch, reducer._take, "process.attempt == report.start and ", "")
