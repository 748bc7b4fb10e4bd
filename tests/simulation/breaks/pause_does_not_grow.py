"""Every pause is as short as the first one."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from play_launch.supervisor import restart
from tests.simulation.rewriting import rewrite

if TYPE_CHECKING:
    import pytest

FOUND_BY: Final = "restarts wait for their pause"


def apply(patch: pytest.MonkeyPatch) -> None:
    rewrite(patch, restart._pause, " * 2.0 ** min(streak, _EXPONENT_LIMIT)", "")
