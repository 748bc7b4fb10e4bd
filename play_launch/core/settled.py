"""What became of something that was asked to come up, and what of a system is not there.

Read off the view, so the same holds for a person who looks at it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from play_launch.core.events import ContainerState, NodeState
from play_launch.core.view import FAILED_STATES

if TYPE_CHECKING:
    from play_launch.core.node_key import NodeKey
    from play_launch.core.view import ContainerView, NodeView, SystemView

_NOT_RUNNING = frozenset({ContainerState.STOPPED, ContainerState.GAVE_UP})
_NOT_UP = frozenset({ContainerState.STOPPED, ContainerState.STARTING})
_NOT_LOADED = FAILED_STATES | {NodeState.UNLOADED}


def is_up(view: SystemView) -> bool:
    """Whether all containers were started and all loads are done, well or not."""
    return not view.waiting and all(each.state not in _NOT_UP for each in view.containers.values())


def absent(view: SystemView) -> dict[str, str]:
    """Name what is declared, is not there, and does not come by itself; with the reason.

    An ordinary process that ended well has done its work. The nodes of a container that does not
    run are not named, for they come with it.
    """
    found: dict[str, str] = {}
    for container in view.containers.values():
        if container.state in _NOT_RUNNING:
            found[container.name] = _said(container.state, container.reason)
            continue
        for key, node in container.nodes.items():
            if node.state in _NOT_LOADED:
                found[str(key)] = _said(node.state, node.reason)
    for process in view.processes.values():
        if process.name in view.dismissed and not process.pid:
            found[process.name] = "it was stopped"
        elif process.failed:
            found[process.name] = process.message or "it has failed"
    return found


def node_settled(view: SystemView, key: NodeKey) -> str | None:
    """Say what became of a node: empty when it is loaded, else why not; None as long as it may be.

    A crash counts as a failure, also of a node that is going to be loaded again.
    """
    container = view.containers.get(key.container)
    node = None if container is None else container.nodes.get(key)
    if container is None or node is None:
        return "it is not declared any more"
    if container.state in _NOT_RUNNING:
        return f"its container is not there: {_said(container.state, container.reason)}"
    return _node(node)


def container_settled(view: SystemView, name: str) -> str | None:
    """Say the same of a container and all of its nodes."""
    container = view.containers.get(name)
    if container is None:
        return "it is not declared any more"
    if container.state in _NOT_RUNNING:
        return _said(container.state, container.reason)
    if container.state is not ContainerState.RUNNING:
        return None
    return _all_of(container)


def member_settled(view: SystemView, name: str, state: ContainerState) -> str | None:
    """Say the same of an ordinary process in this state; it is there as soon as it runs.

    The view may still hold what was said of the process before.
    """
    if state is ContainerState.RUNNING:
        return ""
    if state not in _NOT_RUNNING:
        return None
    process = view.processes.get(name)
    if process is not None and process.ended_well:
        return ""
    return (process.message if process else "") or "it has failed"


def _all_of(container: ContainerView) -> str | None:
    settled = {key: _node(node) for key, node in container.nodes.items()}
    if None in settled.values():
        return None
    failed = [f"{key.name}: {reason}" for key, reason in settled.items() if reason]
    if not failed:
        return ""
    more = f", and {len(failed) - 1} more" if len(failed) > 1 else ""
    return f"{failed[0]}{more}"


def _node(node: NodeView) -> str | None:
    if node.state is NodeState.LOADED:
        return ""
    return _said(node.state, node.reason) if node.state in _NOT_LOADED else None


def _said(state: NodeState | ContainerState, reason: str) -> str:
    return f"{state}: {reason}" if reason else str(state)
