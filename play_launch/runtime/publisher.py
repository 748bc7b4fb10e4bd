"""Publishes events: each is folded into the view once, and passed to the sinks with it."""

from __future__ import annotations

import logging
import time
from typing import TYPE_CHECKING

from play_launch.recording.log_handler import REPORTED_LOGGER
from play_launch.supervisor.events import (
    ComponentEvent,
    ContainerState,
    NodeState,
    NodeStateChanged,
    OutputLine,
    ProcessEvent,
    ProcessEventKind,
)
from play_launch.supervisor.view import SystemView

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from play_launch.process.lines import Line
    from play_launch.supervisor.events import RunEvent, Stream
    from play_launch.supervisor.view import StateSink


_log = logging.getLogger(__name__)
_reported = logging.getLogger(REPORTED_LOGGER)


class Publisher:
    """Passes every event to the sinks, with the view before and after it."""

    def __init__(self, *sinks: StateSink, stamp_ns: Callable[[], int] = time.time_ns) -> None:
        """Take the sinks; ``stamp_ns`` gives the wall-clock time in nanoseconds."""
        self._sinks = list(sinks)
        self.stamp_ns = stamp_ns
        self.view = SystemView()
        self._warnings: set[str] = set()

    def add_sink(self, sink: StateSink) -> None:
        """Pass events to another sink, from now on."""
        self._sinks.append(sink)

    def is_news(self, warning: str) -> bool:
        """Whether a warning that may concern many units alike is logged for the first time."""
        if warning in self._warnings:
            return False
        self._warnings.add(warning)
        return True

    def publish(self, event: RunEvent) -> None:
        """Take one event."""
        before = self.view
        self.view = after = before.after(event)
        for sink in tuple(self._sinks):
            try:
                sink.publish(event, before, after)
            except Exception:  # noqa: BLE001 - a sink must not stop the unit
                self._sinks.remove(sink)
                _log.exception("%s failed and gets no more events", type(sink).__name__)

    def publish_output(self, name: str, pid: int, stream: Stream, lines: Sequence[Line]) -> None:
        """Take what a process wrote."""
        stamp_ns = self.stamp_ns()
        for line in lines:
            self.publish(
                OutputLine(
                    stamp_ns=stamp_ns,
                    process=name,
                    pid=pid,
                    stream=stream,
                    text=line.text,
                    truncated=line.truncated,
                )
            )


_AWAITED = frozenset({NodeState.REQUESTED, NodeState.LOADING, NodeState.UNLOADING})
_UNKNOWN = "the container does not know it"


class EventLog:
    """Logs events; what the display shows as well goes to the logger for that."""

    def __init__(self) -> None:
        self._has_started: set[str] = set()

    def publish(self, event: RunEvent, before: SystemView, _after: SystemView) -> None:
        """Log one event, if it is worth a line."""
        match event:
            case ProcessEvent():
                self._process(event)
            case NodeStateChanged():
                _node(event, before)
            case ComponentEvent(confirmed_by="status"):
                text = "%s is loaded: no event reported it, but %s did when queried"
                _log.warning(text, event.full_node_name, event.container)
            case _:
                pass

    def _process(self, event: ProcessEvent) -> None:
        match event.kind:
            case ProcessEventKind.STARTED:
                self._has_started.add(event.name)
            case ProcessEventKind.RESTARTING:
                _reported.warning("%s: %s", event.name, event.message)
            case ProcessEventKind.GAVE_UP:
                again = " again" if event.name in self._has_started else ""
                if not event.message.startswith("internal error"):  # that has its call stack
                    _reported.error("%s is not started%s: %s", event.name, again, event.message)
            case ProcessEventKind.STOPPING if event.message.startswith("killed: "):
                _log.error("%s is %s", event.name, event.message)
            case _:
                pass


def _node(event: NodeStateChanged, before: SystemView) -> None:
    name, why, container = event.node, event.reason, before.containers.get(event.container)
    known = None if container is None else container.nodes.get(event.key)
    if known is not None and known.state is event.state:
        if event.state in _AWAITED and why and known.unique_id == event.unique_id:
            _log.warning("%s: %s", name, why)
        return
    runs = container is not None and container.state is ContainerState.RUNNING
    match event.state:
        case NodeState.LOAD_FAILED if why == _UNKNOWN:
            _reported.error("%s: %s no longer knows it", name, event.container)
        case NodeState.LOST if runs and why == _UNKNOWN:
            _reported.error("%s: %s no longer knows it", name, event.container)
        case NodeState.LOAD_FAILED:
            _reported.error("%s could not be loaded: %s", name, why)
        case NodeState.CRASHED:
            # Not as an error: the state that follows is reported as one.
            _log.info("%s crashed: %s", name, why)
        case NodeState.GAVE_UP:
            _reported.error("%s is not loaded again: %s", name, why)
        case NodeState.UNLOADED if why and known and known.state is not NodeState.UNLOADING:
            _reported.warning("%s is unloaded: %s", name, why)
        case NodeState.LOADED | NodeState.UNLOADED | NodeState.LOST:
            _log.debug("%s is %s", name, event.state)
        case _:
            pass
