"""Handlers of what only happens while a system runs: they would be dropped without a word."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING, Any

from launch.event_handlers import (
    OnExecutionComplete,
    OnProcessExit,
    OnProcessIO,
    OnProcessStart,
    OnShutdown,
)
from launch.events import Shutdown
from launch.events.process import ProcessExited, ProcessStderr, ProcessStdout
from launch_ros.actions import LifecycleTransition

if TYPE_CHECKING:
    from collections.abc import Sequence

    from play_launch.launch_files.ros_launch.scene import Scene

_HAPPENS_HERE = OnProcessStart | OnProcessExit | OnExecutionComplete
"""What these handle happens in each evaluation, or never."""
_REPORTED = OnProcessIO | OnShutdown
_TARGET = "_OnStateTransition__target_lifecycle_node"


class Unheard:
    """The handlers that decide by a matcher, and have heard of nothing so far."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._handlers: dict[int, tuple[Any, Any]] = {}
        self._heard: set[int] = set()

    def add(self, handler: Any, part: Any) -> None:
        """A handler was registered by a part of the description."""
        if isinstance(handler, _HAPPENS_HERE | _REPORTED) or isinstance(part, LifecycleTransition):
            return
        # What launch registers for itself stands in no launch file.
        if self._scene.places.of_part(part).file:
            self._handlers[id(handler)] = (handler, part)

    def heard(self, handler: Any) -> None:
        """A handler got an event."""
        self._heard.add(id(handler))

    def report(self, actions: Sequence[Any]) -> None:
        """Report the handlers that were not there in vain; `actions` are the processes."""
        for key, (handler, part) in self._handlers.items():
            if _handles(handler, Shutdown(reason="probe")):
                self._scene.lost(part, "it handles the shutdown: its actions are not carried out")
            elif any(
                _handles(handler, kind(text=b"", pid=0, **action.process_details))
                for action in actions
                for kind in (ProcessStdout, ProcessStderr)
            ):
                self._scene.lost(part, "what follows the output of a process")
            elif key not in self._heard and self._may_still_hear(handler, actions):
                kind = type(handler).__name__
                what = f"{kind}: what it handles does not follow from the launch file alone"
                self._scene.lost(part, what)

    def _may_still_hear(self, handler: Any, actions: Sequence[Any]) -> bool:
        target = getattr(handler, _TARGET, None)
        is_registered = any(each is handler for each in self._scene.context._event_handlers)  # noqa: SLF001 - its only list
        return is_registered and (target is None or any(each is target for each in actions))


def decides_by_status(handler: Any, event: Any) -> bool:
    """Whether a handler of an exit with status 0 does not hear of another status."""
    if not isinstance(event, ProcessExited) or isinstance(handler, OnProcessExit):
        return False
    failed = ProcessExited(**event.action.process_details, pid=0, returncode=1)
    return not _handles(handler, failed)


def _handles(handler: Any, event: Any) -> bool:
    # A matcher of the launch file may expect what only the events have that it is for.
    with suppress(Exception):
        return bool(handler.matches(event))
    return False
