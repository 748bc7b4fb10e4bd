"""on_crash: stop_container does nothing."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from play_launch.supervisor import node_rules
from tests.simulation.rewriting import rewrite

if TYPE_CHECKING:
    import pytest

FOUND_BY: Final = "what on_crash says is done"


def apply(patch: pytest.MonkeyPatch) -> None:
    rewrite(
        patch,
        node_rules._follow_crash,
        "process_rules.apply(step, container.name, Fact.STOP, reason)",
        "pass",
    )
