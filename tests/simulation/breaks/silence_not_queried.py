"""The silence of a container about a load means nothing."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, cast

from play_launch.supervisor.events import NodeState
from play_launch.supervisor.node_life import TABLE, NodeCell, NodeFact

if TYPE_CHECKING:
    import pytest

FOUND_BY: Final = "silence is a question"


def apply(patch: pytest.MonkeyPatch) -> None:
    patch.setitem(
        cast("Any", TABLE[NodeState.LOADING]), NodeFact.SILENT, NodeCell(NodeState.LOADING)
    )
