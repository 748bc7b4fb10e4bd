"""A load is sent again without a query."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, cast

from play_launch.supervisor.events import NodeState
from play_launch.supervisor.node_life import TABLE, NodeAction, NodeCell, NodeFact

if TYPE_CHECKING:
    import pytest

FOUND_BY: Final = "never two live attempts of a unit"


def apply(patch: pytest.MonkeyPatch) -> None:
    patch.setitem(
        cast("Any", TABLE[NodeState.REQUESTED]),
        NodeFact.SILENT,
        NodeCell(NodeState.REQUESTED, (NodeAction.LOAD_AGAIN,)),
    )
