"""What a view of the system says in words; the same words on a terminal, in a pipe, at the end."""

from __future__ import annotations

import signal
from typing import TYPE_CHECKING, Final

from play_launch.cli.output import duration
from play_launch.process.exit import Exit
from play_launch.supervisor.events import ContainerState, ProcessEventKind

if TYPE_CHECKING:
    from play_launch.supervisor.view import ContainerView, NodeView, ProcessView

_SECOND: Final = 1_000_000_000
_SHOWN_AFTER: Final = 2 * _SECOND
"""Waiting shorter than this is not worth a number."""
_ASKED_BY: Final = (signal.SIGINT, signal.SIGTERM)
"""Signals that ask for an end; a shell reports them as 128 more."""


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
        case ProcessEventKind.STOPPED:
            return "stopped"
        case ProcessEventKind.WAITING:
            return process.message
        case _:
            return "running"


def container_at_end(before: ContainerView, after: ContainerView) -> str:
    """Describe a container of a run that is over; empty: it had all of its nodes, and stopped well.

    Args:
        before: As it was when the end began.
        after: As it is now.
    """
    state = "" if is_complete(before) else container_status(before)
    if state and before.state in {ContainerState.STARTING, ContainerState.STOPPING}:
        state = f"was {state}"
    crashed = after.crashed_since(before)
    crashes = f"crashed when stopped: {_names(crashed)}" if crashed else ""
    stopped = stop_problem(after.process) if before.process.pid else ""
    return "; ".join(each for each in (state, crashes, stopped) if each)


def process_at_end(before: ProcessView, after: ProcessView, *, dismissed: bool = False) -> str:
    """Describe an ordinary process of a run that is over.

    Args:
        before: As it was when the end began.
        after: As it is now.
        dismissed: Whether a person had stopped it.
    """
    match before.kind:
        case ProcessEventKind.EXITED if dismissed:
            return stop_problem(before) or "stopped"
        case ProcessEventKind.EXITED | ProcessEventKind.GAVE_UP:
            return process_status(before)
        case ProcessEventKind.RESTARTING:
            return f"not restarted: {ending(before.exit_code, before.signal)}"
        case ProcessEventKind.WAITING:
            return f"not started: {before.message}"
        case _ if after.kind is ProcessEventKind.EXITED:
            return stop_problem(after) or "stopped"
        case _:
            return process_status(after)


def stop_problem(process: ProcessView) -> str:
    """Describe an unexpected end of a stopped process; empty if it exited as expected."""
    asked = {128 + number for number in _ASKED_BY}
    is_well = process.signal in _ASKED_BY or (
        not process.signal and process.exit_code in {0, *asked}
    )
    if is_well or process.kind is not ProcessEventKind.EXITED:
        return ""
    return f"stopped: {ending(process.exit_code, process.signal)}"


def ending(exit_code: int, signal: int) -> str:
    """Describe the end of a process."""
    return str(Exit(code=exit_code, signal=signal))


def _waited(since_ns: int, now_ns: int) -> str:
    waited = now_ns - since_ns
    return f" … {duration(waited)}" if since_ns and waited >= _SHOWN_AFTER else ""


def _names(nodes: tuple[NodeView, ...]) -> str:
    more = f" and {len(nodes) - 1} more" if len(nodes) > 1 else ""
    return f"{nodes[0].node}{more}"


def _because(state: str, reason: str) -> str:
    return f"{state}: {reason}" if reason else state
