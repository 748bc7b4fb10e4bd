"""What is worth a line in the log about a node; it follows from the transition alone."""

from __future__ import annotations

from enum import StrEnum, auto
from typing import TYPE_CHECKING, Final

from play_launch.core.events import NodeState
from play_launch.core.node_table import WAITING, NodeInput

if TYPE_CHECKING:
    from collections.abc import Mapping


class NodeReport(StrEnum):
    """What happened, as a reader sees it."""

    LOADED = auto()
    CONFIRMED = auto()
    """Loaded, but no event said so: the container was asked."""
    SLOW = auto()
    """Its constructor still runs, after a long time."""
    FAILED = auto()
    FORGOTTEN = auto()
    """The container lives and does not know the node any more."""
    CRASHED = auto()
    FAULTED = auto()
    """It crashed instead of leaving for the one that replaces it."""
    GAVE_UP = auto()
    UNLOADED = auto()
    UNASKED = auto()
    """Unloaded, and not because we asked: it ended itself, or somebody else unloaded it."""
    LOST = auto()


_OF_STATE: Final[Mapping[NodeState, NodeReport]] = {
    NodeState.LOADED: NodeReport.LOADED,
    NodeState.LOAD_FAILED: NodeReport.FAILED,
    NodeState.CRASHED: NodeReport.CRASHED,
    NodeState.GAVE_UP: NodeReport.GAVE_UP,
    NodeState.UNLOADED: NodeReport.UNLOADED,
    NodeState.LOST: NodeReport.LOST,
}
_UNKNOWN: Final = frozenset({NodeInput.STATUS_UNKNOWN, NodeInput.STATUS_UNKNOWN_AGAIN})
_THERE: Final = frozenset({NodeState.REQUESTED, NodeState.LOADING, NodeState.LOADED})


def report_of(before: NodeState, said: NodeInput, after: NodeState) -> NodeReport | None:
    """Say what a transition means to a reader; None: nothing that is worth a line."""
    if said is NodeInput.STATUS_CONSTRUCTING and before in WAITING:
        return NodeReport.SLOW
    if after is before:
        return None
    if said is NodeInput.STATUS_LOADED and after is NodeState.LOADED:
        return NodeReport.CONFIRMED
    if said is NodeInput.CRASHED and after is NodeState.REQUESTED:
        return NodeReport.FAULTED
    if said in _UNKNOWN and after in {NodeState.LOAD_FAILED, NodeState.LOST}:
        return NodeReport.FORGOTTEN
    if said is NodeInput.UNLOADED and before in _THERE and after is NodeState.UNLOADED:
        return NodeReport.UNASKED
    return _OF_STATE.get(after)
