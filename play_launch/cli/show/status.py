"""What a view of the system says in words; the same words on a terminal, in a pipe, at the end."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from play_launch.cli.show.durations import duration
from play_launch.core.events import ContainerState, ProcessEventKind
from play_launch.process.exit import Exit

if TYPE_CHECKING:
    from play_launch.core.view import ContainerView, NodeView, ProcessView

_SECOND: Final = 1_000_000_000
_SHOWN_AFTER: Final = 2 * _SECOND
"""Waiting shorter than this is not worth a number."""


def container_status(container: ContainerView, now_ns: int = 0) -> str:
    """Describe a container and its nodes at ``now_ns`` (nanoseconds since the epoch).

    For example ``loaded 3/4, waiting on /talker … 12 s``; without ``now_ns`` no time is given.
    """
    if container.state is ContainerState.STOPPED:
        return _because("stopped", container.reason)
    if container.state is ContainerState.STARTING:
        return _because("starting", container.reason) + _waited(container.since_ns, now_ns)
    if container.state is not ContainerState.RUNNING:
        return _because(container.state.value, container.reason)
    parts = [f"loaded {container.loaded}/{container.total}"]
    if container.failed:
        parts.append(f"failed: {_names(container.failed)}")
    if container.unloaded:
        parts.append(f"unloaded: {_names(container.unloaded)}")
    if waiting := container.waiting:
        oldest = min(node.since_ns for node in waiting)
        parts.append(f"waiting on {_names(waiting)}{_waited(oldest, now_ns)}")
    return ", ".join(parts)


def is_complete(container: ContainerView) -> bool:
    """Whether a container runs and has all of its nodes."""
    return container.state is ContainerState.RUNNING and container.loaded == container.total


def process_status(process: ProcessView) -> str:
    """Describe an ordinary process: ``running``, ``exited with signal 11 (SIGSEGV)`` …."""
    match process.kind:
        case ProcessEventKind.EXITED:
            return ending(process.exit_code, process.signal)
        case ProcessEventKind.RESTARTING:
            return _because("restarting", process.message)
        case ProcessEventKind.GAVE_UP:
            return _because("gave up", process.message)
        case ProcessEventKind.STOPPING:
            return "stopping"
        case ProcessEventKind.WAITING:
            return process.message
        case _:
            return "running"


def ending(exit_code: int, signal: int) -> str:
    """Say how a process ended."""
    return str(Exit(code=exit_code, signal=signal))


def _waited(since_ns: int, now_ns: int) -> str:
    waited = now_ns - since_ns
    return f" … {duration(waited)}" if since_ns and waited >= _SHOWN_AFTER else ""


def _names(nodes: tuple[NodeView, ...]) -> str:
    more = f" and {len(nodes) - 1} more" if len(nodes) > 1 else ""
    return f"{nodes[0].node}{more}"


def _because(state: str, reason: str) -> str:
    return f"{state}: {reason}" if reason else state
