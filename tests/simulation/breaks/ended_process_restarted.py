"""A process is started again although on_exit says otherwise."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from play_launch.supervisor import process_rules
from tests.simulation.rewriting import rewrite

if TYPE_CHECKING:
    import pytest

FOUND_BY: Final = "what has ended is not started again"


def apply(patch: pytest.MonkeyPatch) -> None:
    rewrite(patch, process_rules._process_exited, "is not OnExit.RESTART", "is OnExit.SHUTDOWN")
