"""on_crash: ignore has the node loaded again."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from play_launch.supervisor import restart
from tests.simulation.rewriting import rewrite

if TYPE_CHECKING:
    import pytest

FOUND_BY: Final = "what on_crash says is done"


def apply(patch: pytest.MonkeyPatch) -> None:
    rewrite(patch, restart.follow_up, "return history, Ignore()", "return history, Restart(1.0)")
