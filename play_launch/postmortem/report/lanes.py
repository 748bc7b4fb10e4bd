"""When each row of the timeline was in which state."""

from __future__ import annotations

from array import array
from enum import IntEnum
from typing import Final

from msgspec import Struct, field

from play_launch.supervisor.events import ContainerState, NodeState, ProcessEventKind

MOST: Final = 300_000
"""Stays that a page shows; further ones are counted."""


class Shown(IntEnum):
    """How a state is drawn."""

    CONSTRUCTING = 0
    LOADED = 1
    """It is there: a container or a process runs."""
    CRASHED = 2
    """It failed, and is not there."""
    AWAY = 3
    """It is not there, and nothing is wrong with it."""


OF_NODE: Final = {
    NodeState.PENDING: Shown.AWAY,
    NodeState.REQUESTED: Shown.CONSTRUCTING,
    NodeState.LOADING: Shown.CONSTRUCTING,
    NodeState.LOADED: Shown.LOADED,
    NodeState.LOAD_FAILED: Shown.CRASHED,
    NodeState.UNLOADING: Shown.AWAY,
    NodeState.UNLOADED: Shown.AWAY,
    NodeState.CRASHED: Shown.CRASHED,
    NodeState.GAVE_UP: Shown.CRASHED,
    NodeState.LOST: Shown.AWAY,
}
OF_CONTAINER: Final = {
    ContainerState.STOPPED: Shown.AWAY,
    ContainerState.STARTING: Shown.CONSTRUCTING,
    ContainerState.RUNNING: Shown.LOADED,
    ContainerState.KILLING: Shown.CRASHED,
    ContainerState.BACKOFF: Shown.CRASHED,
    ContainerState.GAVE_UP: Shown.CRASHED,
    ContainerState.STOPPING: Shown.AWAY,
}
OF_PROCESS: Final = {
    ProcessEventKind.STARTED: Shown.LOADED,
    ProcessEventKind.READY: Shown.LOADED,
    ProcessEventKind.EXITED: Shown.AWAY,
    ProcessEventKind.RESTARTING: Shown.CRASHED,
    ProcessEventKind.GAVE_UP: Shown.CRASHED,
    ProcessEventKind.STOPPING: Shown.AWAY,
    ProcessEventKind.WAITING: Shown.AWAY,
    ProcessEventKind.STOPPED: Shown.AWAY,
}
"""Of a process that is not a container of the session."""


class Lanes(Struct):
    """Stays of rows in states, from begin to end; times are milliseconds since the start."""

    rows: array[int] = field(default_factory=lambda: array("H"))
    states: array[int] = field(default_factory=lambda: array("B"))
    begins: array[float] = field(default_factory=lambda: array("d"))
    ends: array[float] = field(default_factory=lambda: array("d"))
    left_out: int = 0
    _now: dict[int, tuple[Shown, float]] = field(default_factory=dict)

    def change(self, row: int, at: float, shown: Shown) -> None:
        """Take a state; the same as before changes nothing."""
        before = self._now.get(row)
        if before is not None:
            if before[0] is shown:
                return
            self._add(row, *before, at)
        self._now[row] = (shown, at)

    def end(self, at: float) -> None:
        """End what goes on, as the recording does."""
        for row, (shown, begin) in self._now.items():
            self._add(row, shown, begin, at)
        self._now.clear()

    def _add(self, row: int, shown: Shown, begin: float, end: float) -> None:
        if len(self.rows) >= MOST:
            self.left_out += 1
            return
        self.rows.append(row)
        self.states.append(shown)
        self.begins.append(begin)
        self.ends.append(max(begin, end))
