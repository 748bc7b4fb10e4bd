"""Reports of an old load count."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from play_launch.supervisor import node_rules
from tests.simulation.rewriting import rewrite

if TYPE_CHECKING:
    import pytest

FOUND_BY: Final = "events of an old attempt change nothing"


def apply(patch: pytest.MonkeyPatch) -> None:
    rewrite(
        patch,
        node_rules._meant,
        "said.attempt and node.attempt == said.attempt",
        "said.attempt and node.attempt >= said.attempt",
    )
