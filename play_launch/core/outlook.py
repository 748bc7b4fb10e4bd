"""How a condition about a member or a composable node stands, from what is known about it. Pure."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from msgspec import Struct

from play_launch.core.dependency import Condition
from play_launch.core.events import ContainerState, NodeState, ProcessEventKind
from play_launch.core.order import Look, Standing

if TYPE_CHECKING:
    from collections.abc import Mapping

    from play_launch.core.view import ProcessView

HOLDS: Final = Look(Standing.HOLDS)
OPEN: Final = Look(Standing.OPEN)

_THERE: Final = {
    Condition.STARTED: frozenset({NodeState.LOADING, NodeState.LOADED}),
    Condition.LOADED: frozenset({NodeState.LOADED}),
}
_GONE: Final = {
    NodeState.LOAD_FAILED: "it failed to load",
    NodeState.CRASHED: "it crashed",
    NodeState.GAVE_UP: "it is not loaded again",
    NodeState.UNLOADED: "it was unloaded",
    NodeState.UNLOADING: "it is being unloaded",
}


class MemberFacts(Struct, frozen=True):
    """A container or process, as its member knows it."""

    state: ContainerState
    wanted: bool
    is_at_rest: bool
    """Whether nothing of it is left, its output included, and it does not start by itself."""
    process: ProcessView | None = None
    reason: str = ""
    """Why it is in this state."""


class NodeFacts(Struct, frozen=True):
    """A composable node, as its container's member knows it."""

    state: NodeState
    wanted: bool = True
    comes_back: bool = False
    """Whether it is going to be loaded again by itself."""
    reason: str = ""


def of_member(condition: Condition, facts: MemberFacts) -> Look:
    """Look at STARTED or EXITED."""
    if facts.state is ContainerState.RUNNING:
        return HOLDS if condition is Condition.STARTED else OPEN
    if facts.state is ContainerState.GAVE_UP:
        return _never("it gave up", facts.reason)
    if facts.state is ContainerState.STOPPED and facts.process is not None:
        if facts.process.ended_well:
            return HOLDS
        if facts.process.kind is ProcessEventKind.EXITED:
            return _never("it ended", facts.process.message)
    is_leaving = facts.state in {ContainerState.STOPPED, ContainerState.STOPPING}
    return _never("it is stopped", facts.reason) if is_leaving and not facts.wanted else OPEN


def of_node(condition: Condition, node: NodeFacts, container: MemberFacts) -> Look:
    """Look at STARTED or LOADED of a composable node."""
    if node.state in _THERE[condition]:
        return HOLDS
    look = of_member(Condition.STARTED, container)
    if look.standing is Standing.NEVER:
        return _never("its container", look.reason)
    if node.state in _GONE and not node.comes_back:
        return _never(_GONE[node.state], node.reason)
    return OPEN


def of_all_nodes(nodes: Mapping[str, NodeFacts], container: MemberFacts) -> Look:
    """Look at LOADED of a container: it runs, and so do all of its nodes."""
    look = of_member(Condition.STARTED, container)
    for name, node in nodes.items():
        each = of_node(Condition.LOADED, node, container)
        if each.standing is Standing.NEVER and look.standing is not Standing.NEVER:
            return _never(name, each.reason)
        if each.standing is Standing.OPEN and look.standing is Standing.HOLDS:
            look = OPEN
    return look


def of_what_it_does(does: bool, facts: MemberFacts) -> Look:
    """Look at what a member does while it runs: it writes a line, its node joins the graph."""
    if does:
        return HOLDS
    look = of_member(Condition.STARTED, facts)
    if look.standing is Standing.HOLDS and facts.is_at_rest:
        return _never("it ended", "")
    # Its last lines are still to be read.
    return OPEN if look.standing is Standing.HOLDS or not facts.is_at_rest else look


def _never(what: str, why: str) -> Look:
    return Look(Standing.NEVER, f"{what}: {why}" if why else what)
