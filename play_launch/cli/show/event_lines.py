"""Lines of `replay` and `inspect`: which events have one, and its form."""

from __future__ import annotations

import time
import zlib
from typing import TYPE_CHECKING, Any, Final

from msgspec import Struct

from play_launch.cli.output import RED, RESET, YELLOW, clock, printable
from play_launch.control.event_words import OWN_NAME, words_of
from play_launch.recording.console_format import ERROR, INFO, WARN
from play_launch.recording.log_handler import REPORTED_LOGGER
from play_launch.supervisor.events import (
    ActionEvent,
    ActionPhase,
    ComponentEvent,
    ComponentEventKind,
    ContainerState,
    ContainerStateChanged,
    ExpectationChanged,
    LogRecord,
    ManagedNodeChanged,
    ManagedState,
    NodeState,
    NodeStateChanged,
    OutputLine,
    ProcessEvent,
    ProcessEventKind,
    RunEvent,
    WantChanged,
    Withdrawn,
)
from play_launch.supervisor.view import is_guest

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from play_launch.supervisor.view import SystemView

_PASSING: Final = frozenset(
    (NodeState.PENDING, NodeState.REQUESTED, NodeState.LOADING, NodeState.UNLOADED)
)
"""States of a node that are to be expected, unless there is a reason."""
_OF_PROCESSES: Final = frozenset(("started", "waiting", "exited", "restarting", "gave_up"))
_NAME_COLOURS: Final = tuple(f"\x1b[{code}m" for code in (36, 35, 34, 32, 96, 95, 94, 92))


class DisplayLine(Struct, frozen=True):
    """One line to show."""

    stamp_ns: int
    source: str
    """Process, container or ``play-launch``."""
    text: str
    level: int = INFO
    is_progress: bool = False
    """The live view has the same content."""


def line_of(event: RunEvent, before: SystemView, after: SystemView) -> DisplayLine | None:
    """Return the line for an event, given the view before and after it; most events have none."""
    is_progress = _is_progress(event, before, after)
    if is_progress is None:
        return None
    level, source, text = words_of(event)
    if isinstance(event, OutputLine) and event.truncated:
        text += " [cut]"
    elif isinstance(event, ProcessEvent) and event.kind is ProcessEventKind.EXITED:
        level = INFO if is_progress else ERROR
    elif isinstance(event, NodeStateChanged) and event.state is NodeState.LOADED:
        container = after.containers[event.container]
        text += "" if event.reason else f" ({container.loaded}/{container.total})"
    return DisplayLine(event.stamp_ns, source, text, level, is_progress)


def _is_progress(event: RunEvent, before: SystemView, after: SystemView) -> bool | None:
    """Whether the live view shows an event as well; None: it has no line."""
    match event:
        case OutputLine() | WantChanged() | Withdrawn():
            return False
        case LogRecord() if event.level >= WARN and event.name != REPORTED_LOGGER:
            return False
        case ComponentEvent() if is_guest(event.unique_id, event.attempt):
            is_late = _was_stopping(event.container, before)
            return None if is_late or event.kind is ComponentEventKind.LOADING else False
        case NodeStateChanged():
            return _is_node_progress(event, before, after)
        case ContainerStateChanged(state=ContainerState.STARTING) if event.reason:
            return True
        case ProcessEvent(kind=ProcessEventKind.STARTED | ProcessEventKind.WAITING):
            return True
        case ProcessEvent(kind=ProcessEventKind.RESTARTING | ProcessEventKind.GAVE_UP):
            return False
        case ProcessEvent(kind=ProcessEventKind.EXITED):
            return not (event.exit_code or event.signal) or _was_stopping(event.name, before)
        case ActionEvent():
            return event.phase is ActionPhase.DONE
        case ExpectationChanged():
            return event.is_met
        # In the other states, the states of the node itself say the same.
        case ManagedNodeChanged() if event.state not in {ManagedState.ABSENT, ManagedState.ASKED}:
            return event.state is not ManagedState.FAILED
        case _:
            return None


def _is_node_progress(
    event: NodeStateChanged, before: SystemView, after: SystemView
) -> bool | None:
    container = before.containers.get(event.container)
    was = container.nodes.get(event.key) if container else None
    if was is not None and was.state is event.state:
        return True if event.state in {NodeState.LOADING, NodeState.PENDING} else None
    match event.state:
        case NodeState.LOADED:
            return not event.reason and not event.reloads
        case NodeState.PENDING if event.reason:
            return True
        case NodeState.LOAD_FAILED | NodeState.CRASHED | NodeState.GAVE_UP:
            return False
        # A node that had crashed was down before its container exited.
        case NodeState.LOST if was is None or was.state is not NodeState.CRASHED:
            return False
        # An orderly stop needs no reason; an unload that was requested has no reason.
        case NodeState.UNLOADED if event.reason:
            is_running = after.containers[event.container].state is ContainerState.RUNNING
            return False if is_running else None
        case _:
            return None


def has_line(event: Mapping[str, Any]) -> bool:
    """As `line_of`, for an event of another machine, of which there is no view."""
    match event["event"]:
        case "node":
            return event["state"] not in _PASSING or bool(event["reason"])
        case "process":
            return event["kind"] in _OF_PROCESSES
        case "managed":
            return event["state"] not in {ManagedState.ABSENT, ManagedState.ASKED}
        case "log":
            return bool(event["level"] >= WARN and event["name"] != REPORTED_LOGGER)
        case kind:
            return kind in {"action", "expectation", "machine", "output", "want", "withdrawn"}


def _was_stopping(name: str, view: SystemView) -> bool:
    container = view.containers.get(name)
    process = container.process if container else view.processes.get(name)
    return process is not None and process.kind is ProcessEventKind.STOPPING


def missed_line(missed: int) -> DisplayLine:
    text = f"skipped {missed} lines (the terminal is too slow); they are in the recording"
    return DisplayLine(time.time_ns(), OWN_NAME, text, WARN)


def format_lines(lines: Iterable[DisplayLine], *, times: bool, colour: bool) -> str:
    """Lay out lines, each with its source in front; every one ends in a line end.

    Node output is cleaned of what would disturb the terminal; a message of several lines gets the
    source in front of each.
    """
    written: list[str] = []
    for line in lines:
        head = f"[{line.source}]"
        if colour:
            # By name, not by order of appearance: a node keeps its colour from run to run.
            name = line.source.encode("utf-8", "replace")
            head = f"{_NAME_COLOURS[zlib.crc32(name) % len(_NAME_COLOURS)]}{head}{RESET}"
        head = f"{clock(line.stamp_ns)} {head}" if times else head
        paint = (RED if line.level >= ERROR else YELLOW) if colour and line.level >= WARN else ""
        for text in line.text.split("\n"):
            clean = printable(text, colour=colour)
            written.append(f"{head} {paint}{clean}{RESET if paint else ''}\n")
    return "".join(written)
