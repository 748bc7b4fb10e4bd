"""on_crash: shutdown does nothing."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from play_launch.supervisor import node_rules
from tests.simulation.rewriting import rewrite

if TYPE_CHECKING:
    import pytest

FOUND_BY: Final = "an end with consequences ends all"


def apply(patch: pytest.MonkeyPatch) -> None:
    rewrite(patch, node_rules._follow_crash, "process_rules.request_stop(step, reason)", "pass")
