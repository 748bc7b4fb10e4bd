"""When an action counts as carried out, and when it never will be: decided from states alone."""

from __future__ import annotations

from enum import StrEnum
from typing import Final

from msgspec import Struct

from play_launch.supervisor.events import ContainerState, NodeState
from play_launch.supervisor.goal_life import ManagedState


class Action(StrEnum):
    """What a person can have done to a running system."""

    START = "start"
    STOP = "stop"
    RESTART = "restart"
    LOAD = "load"
    UNLOAD = "unload"
    RELOAD = "reload"
    SIGNAL = "signal"


FOR_MEMBERS: Final = frozenset({Action.START, Action.STOP, Action.RESTART})
FOR_NODES: Final = frozenset({Action.LOAD, Action.UNLOAD, Action.RELOAD})


class Verdict(Struct, frozen=True):
    """What became of an action on one member or node."""

    is_done: bool
    reason: str = ""


_AT_REST: Final = frozenset({ContainerState.STOPPED, ContainerState.GAVE_UP})
_GONE: Final = frozenset(
    {
        NodeState.PENDING,
        NodeState.UNLOADED,
        NodeState.CRASHED,
        NodeState.GAVE_UP,
        NodeState.LOAD_FAILED,
        NodeState.LOST,
    }
)
_STAYS_AWAY: Final = frozenset({NodeState.LOAD_FAILED, NodeState.GAVE_UP, NodeState.UNLOADED})
_NOT_LOADED: Final = frozenset(
    {NodeState.LOAD_FAILED, NodeState.GAVE_UP, NodeState.UNLOADED, NodeState.CRASHED}
)


def of_member(state: ContainerState, *, reason: str = "") -> Verdict | None:
    """Judge a start or restart after it was begun; None: it is under way.

    Args:
        state: Of the container or process by now.
        reason: Why it is in this state.
    """
    if state is ContainerState.RUNNING:
        return Verdict(is_done=True)
    if state in _AT_REST:
        return Verdict(is_done=False, reason=reason or f"it has {_ended(state)}")
    return None


def of_stop(state: ContainerState | None, *, reason: str = "") -> Verdict:
    """Judge a stop when it is over.

    Args:
        state: Of the container or process when nothing was left of it; None: it was wanted again.
        reason: Why it is in this state.
    """
    if state is None:
        return Verdict(is_done=False, reason="it was started again meanwhile")
    has_stopped = state is ContainerState.STOPPED or not reason
    return Verdict(has_stopped, "" if has_stopped else reason)


def of_node(
    action: Action, state: NodeState, container: ContainerState, reason: str = ""
) -> Verdict | None:
    """Judge a load, unload or reload after it was begun; None: it is under way.

    Args:
        action: What was asked for.
        state: Of the node by now.
        container: State of its container.
        reason: Why the node is in its state.
    """
    if action is Action.UNLOAD:
        return Verdict(is_done=True) if state in _GONE else None
    if state is NodeState.LOADED:
        return Verdict(is_done=True)
    if container in _AT_REST:
        return Verdict(is_done=False, reason=f"its container has {_ended(container)}")
    # Until its container is ready, it only is wanted.
    if container is ContainerState.RUNNING and state in _NOT_LOADED:
        return Verdict(is_done=False, reason=reason or f"it is {state.value}")
    return None


def member_is_up(
    state: ContainerState, *, ended_well: bool = False, reason: str = ""
) -> Verdict | None:
    """Judge whether a container or process is there, or has done its work; None: not yet."""
    if state is ContainerState.RUNNING or (state is ContainerState.STOPPED and ended_well):
        return Verdict(is_done=True)
    if state in _AT_REST:
        return Verdict(is_done=False, reason=reason or f"it has {_ended(state)}")
    return None


def node_is_loaded(state: NodeState, container: ContainerState, reason: str = "") -> Verdict | None:
    """Judge whether a node is loaded; one that crashed or was lost may come back."""
    if state is NodeState.LOADED:
        return Verdict(is_done=True)
    if container in _AT_REST:
        return Verdict(is_done=False, reason=f"its container has {_ended(container)}")
    if state in _STAYS_AWAY:
        return Verdict(is_done=False, reason=reason or f"it is {state.value}")
    return None


def managed_is_active(state: ManagedState | None, reason: str = "") -> Verdict | None:
    """Judge whether a managed node that is brought there is active; None: not yet."""
    if state is ManagedState.ACTIVE:
        return Verdict(is_done=True)
    if state in {ManagedState.FAILED, ManagedState.FINALIZED}:
        return Verdict(is_done=False, reason=reason or f"it is {state}")
    return None


def _ended(state: ContainerState) -> str:
    return "given up" if state is ContainerState.GAVE_UP else "stopped"
