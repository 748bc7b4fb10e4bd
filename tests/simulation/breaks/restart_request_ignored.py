"""A process that runs is not replaced at request."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from play_launch.supervisor import reducer
from tests.simulation.rewriting import rewrite

if TYPE_CHECKING:
    import pytest

FOUND_BY: Final = "what is asked for is done"


def apply(patch: pytest.MonkeyPatch) -> None:
    rewrite(patch, reducer._operate_process, "(said.anew or not runs)", "(not runs)")
