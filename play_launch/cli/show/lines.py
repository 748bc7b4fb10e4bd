"""Lines of `replay` for events."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from msgspec import Struct

from play_launch.cli.output import duration
from play_launch.cli.show.status import container_status, ending
from play_launch.recording.console_format import ERROR, INFO, WARN, line_level
from play_launch.supervisor.events import (
    REPORTED_LOGGER,
    ActionEvent,
    ActionPhase,
    ContainerState,
    ContainerStateChanged,
    LogRecord,
    ManagedNodeChanged,
    NodeState,
    NodeStateChanged,
    OutputLine,
    ProcessEvent,
    ProcessEventKind,
    RunEvent,
    Withdrawn,
)
from play_launch.supervisor.goal_life import ManagedState

if TYPE_CHECKING:
    from play_launch.supervisor.view import ProcessView, SystemView

OWN_NAME: Final = "play-launch"
_UNSAID: Final = frozenset({ManagedState.ABSENT, ManagedState.ASKED})
"""States of a managed node that say nothing that its own do not say."""


class Line(Struct, frozen=True):
    """One line to show."""

    stamp_ns: int
    source: str
    """Process, container or ``play-launch``."""
    text: str
    level: int = INFO
    is_progress: bool = False
    """It repeats what the live view shows."""


def line_of(event: RunEvent, before: SystemView, after: SystemView) -> Line | None:
    """Return the line for an event, given the view before and after it; most events have none."""
    match event:
        case OutputLine():
            text = f"{event.text} [cut]" if event.truncated else event.text
            return Line(event.stamp_ns, event.process, text, line_level(event))
        case LogRecord() if event.level >= WARN and event.name != REPORTED_LOGGER:
            return Line(event.stamp_ns, OWN_NAME, event.message, event.level)
        case NodeStateChanged():
            return _node_line(event, before, after)
        case ProcessEvent():
            return _process_line(event, before)
        case ActionEvent():
            return _action_line(event)
        case ManagedNodeChanged(state=ManagedState.FAILED):
            return Line(event.stamp_ns, event.node, f"autostart failed: {event.reason}", ERROR)
        case ManagedNodeChanged() if event.state not in _UNSAID:
            return Line(event.stamp_ns, event.node, f"is {event.state}", is_progress=True)
        case ContainerStateChanged(state=ContainerState.STARTING) if event.reason:
            return Line(event.stamp_ns, event.container, event.reason, is_progress=True)
        case Withdrawn():
            reason = f": {event.reason}" if event.reason else ""
            return Line(event.stamp_ns, event.key, f"taken out of the system{reason}")
        case _:
            return None


def _action_line(event: ActionEvent) -> Line | None:
    names = ", ".join(event.targets[:_MOST_TARGETS])
    if more := event.targets[_MOST_TARGETS:]:
        names += f" and {len(more)} more"
    what = f"{event.action} {names}".rstrip()
    match event.phase:
        case ActionPhase.REQUESTED:
            besides = f" ({event.reason})" if event.reason else ""
            who = f"user {event.uid}, pid {event.pid}"
            command = f": {event.command}" if event.command else ""
            text = f"{what}{besides}: asked for by {who}{command}"
            return Line(event.stamp_ns, OWN_NAME, text)
        case ActionPhase.FAILED:
            return Line(event.stamp_ns, OWN_NAME, f"{what} failed: {event.reason}", WARN)
        case ActionPhase.DONE:
            return Line(event.stamp_ns, OWN_NAME, f"{what}: done", is_progress=True)


_MOST_TARGETS: Final = 5


def _node_line(event: NodeStateChanged, before: SystemView, after: SystemView) -> Line | None:
    container = after.containers[event.container]
    known = before.containers.get(event.container)
    was = known.nodes.get(event.key) if known else None
    repeated = was is not None and was.state is event.state
    reason = f": {event.reason}" if event.reason else ""
    match event.state:
        case NodeState.LOADED if not repeated:
            took = f" after {duration(event.elapsed_ns)}" if event.elapsed_ns else ""
            again = " again" if event.reloads else ""
            # In an isolated container it is the pid of a process that holds nothing else.
            pid = f", pid {event.pid}" if event.pid not in (0, container.process.pid) else ""
            count = f"({container.loaded}/{container.total})"
            text = f"{event.node} loaded{again}{took} {count}{pid}{reason}"
            # A reason says that something was not as usual; that is worth a line of its own.
            usual = not reason and not again
            return Line(event.stamp_ns, event.container, text, is_progress=usual)
        case NodeState.PENDING if event.reason:
            text = f"{event.node} {event.reason}"
            return Line(event.stamp_ns, event.container, text, is_progress=True)
        case NodeState.LOADING if repeated:
            text = container_status(container, event.stamp_ns) + reason
            return Line(event.stamp_ns, event.container, text, is_progress=True)
        case NodeState.LOAD_FAILED | NodeState.CRASHED | NodeState.GAVE_UP if not repeated:
            text = f"{event.node} {_VERBS[event.state]}{reason}"
            return Line(event.stamp_ns, event.container, text, ERROR)
        # A node that had crashed was down before its container exited.
        case NodeState.LOST if not repeated and not (was and was.state is NodeState.CRASHED):
            return Line(event.stamp_ns, event.container, f"{event.node} lost{reason}", WARN)
        # An orderly stop needs no reason; an unload that was asked for has no reason.
        case NodeState.UNLOADED if reason and container.state is ContainerState.RUNNING:
            return Line(event.stamp_ns, event.container, f"{event.node} unloaded{reason}", WARN)
        case _:
            return None


_VERBS: Final = {
    NodeState.LOAD_FAILED: "failed to load",
    NodeState.CRASHED: "crashed",
    NodeState.GAVE_UP: "is not loaded again",
}


def _process_line(event: ProcessEvent, before: SystemView) -> Line | None:
    match event.kind:
        case ProcessEventKind.STARTED:
            # Without a pid it is an attached container.
            text = f"started, pid {event.pid}" if event.pid else "attaching"
            return Line(event.stamp_ns, event.name, text, is_progress=True)
        case ProcessEventKind.EXITED:
            text = event.message or ending(event.exit_code, event.signal)
            ended_badly = event.exit_code != 0 or event.signal != 0
            level = ERROR if ended_badly and not _was_stopping(event.name, before) else INFO
            return Line(event.stamp_ns, event.name, text, level, is_progress=level == INFO)
        case ProcessEventKind.RESTARTING:
            text = event.message or f"restarting, {event.restarts} times so far"
            return Line(event.stamp_ns, event.name, text, WARN)
        case ProcessEventKind.GAVE_UP:
            return Line(event.stamp_ns, event.name, event.message or "not started again", ERROR)
        case ProcessEventKind.WAITING:
            return Line(event.stamp_ns, event.name, event.message, is_progress=True)
        case ProcessEventKind.READY | ProcessEventKind.STOPPING | ProcessEventKind.STOPPED:
            return None


def _was_stopping(name: str, view: SystemView) -> bool:
    process: ProcessView | None = view.processes.get(name)
    if container := view.containers.get(name):
        process = container.process
    return process is not None and process.kind is ProcessEventKind.STOPPING
