"""on_crash: ignore has the node loaded again."""

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
        "case OnCrash.RELOAD:",
        "case OnCrash.RELOAD | OnCrash.IGNORE:",
    )
