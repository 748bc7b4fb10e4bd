"""States of containers and processes in words, for the live view and the summary."""

from __future__ import annotations

import signal
from typing import TYPE_CHECKING, Final

from play_launch.cli.output import duration
from play_launch.process.exit import Exit
from play_launch.supervisor.events import ContainerState, ProcessEventKind

if TYPE_CHECKING:
    from play_launch.supervisor.view import ContainerView, NodeView, ProcessView

_SHOWN_AFTER_NS: Final = 2_000_000_000
"""A shorter wait is shown without its time."""
_STOP_SIGNALS: Final = (signal.SIGINT, signal.SIGTERM)


def container_status(container: ContainerView, now_ns: int = 0) -> str:
    """Describe a container and its nodes at ``now_ns`` (nanoseconds since the epoch).

    For example ``loaded 3/4, waiting on /talker … 12 s``; without ``now_ns`` no time is given.
    """
    if container.state is not ContainerState.RUNNING:
        is_starting = container.state is ContainerState.STARTING
        waited = _waited(container.since_ns, now_ns) if is_starting else ""
        return _because(container.state.value, container.reason) + waited
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
            return ending(process)
        case ProcessEventKind.RESTARTING | ProcessEventKind.GAVE_UP:
            return _because(process.kind.name.lower().replace("_", " "), process.message)
        case ProcessEventKind.STOPPING | ProcessEventKind.STOPPED:
            return process.kind.name.lower()
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
        dismissed: Whether an operator had stopped it.
    """
    match before.kind:
        case ProcessEventKind.EXITED if dismissed:
            return stop_problem(before) or "stopped"
        case ProcessEventKind.EXITED | ProcessEventKind.GAVE_UP:
            return process_status(before)
        case ProcessEventKind.RESTARTING:
            return f"not restarted: {ending(before)}"
        case ProcessEventKind.WAITING:
            return f"not started: {before.message}"
        case _ if after.kind is ProcessEventKind.EXITED:
            return stop_problem(after) or "stopped"
        case _:
            return process_status(after)


def stop_problem(process: ProcessView) -> str:
    """Describe an unexpected end of a stopped process; empty if it exited as expected."""
    # A shell reports a signal as 128 more.
    expected = {0, *(128 + number for number in _STOP_SIGNALS)}
    is_expected = process.signal in _STOP_SIGNALS or (
        not process.signal and process.exit_code in expected
    )
    if is_expected or process.kind is not ProcessEventKind.EXITED:
        return ""
    return f"stopped: {ending(process)}"


def ending(process: ProcessView) -> str:
    """Describe the end of a process."""
    return str(Exit(code=process.exit_code, signal=process.signal))


def _waited(since_ns: int, now_ns: int) -> str:
    waited = now_ns - since_ns
    return f" … {duration(waited)}" if since_ns and waited >= _SHOWN_AFTER_NS else ""


def _names(nodes: tuple[NodeView, ...]) -> str:
    more = f" and {len(nodes) - 1} more" if len(nodes) > 1 else ""
    return f"{nodes[0].node}{more}"


def _because(state: str, reason: str) -> str:
    return f"{state}: {reason}" if reason else state
