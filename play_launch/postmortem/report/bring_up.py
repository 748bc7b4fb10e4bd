"""How the system came up, and what took longest."""

from __future__ import annotations

from typing import Final

from msgspec import Struct, field

from play_launch.supervisor.events import (
    ContainerState,
    ContainerStateChanged,
    NodeState,
    NodeStateChanged,
)

MOST: Final = 15
"""Nodes that a page lists, the latest first."""
_ENDS: Final = {
    NodeState.LOADED: "loaded",
    NodeState.LOAD_FAILED: "failed to load",
    NodeState.CRASHED: "crashed",
    NodeState.GAVE_UP: "gave up",
    NodeState.LOST: "lost its container",
    NodeState.UNLOADED: "unloaded",
}


class Arrival(Struct):
    """How one node came up; times are milliseconds since the start, None where unknown."""

    row: int
    starting: float | None = None
    """When its container was started."""
    running: float | None = None
    """When its container was ready."""
    requested: float | None = None
    constructing: float | None = None
    end: float | None = None
    """When it was loaded, or failed."""
    result: str = ""
    """``loaded``, ``crashed``, ...; empty: it never came up."""


class BringUp(Struct):
    """First arrivals, folded from changes of state."""

    arrivals: dict[int, Arrival] = field(default_factory=dict)
    _starting: dict[str, float] = field(default_factory=dict)
    _running: dict[str, float] = field(default_factory=dict)

    def container(self, at: float, event: ContainerStateChanged) -> None:
        """Take a change of a container's state."""
        match event.state:
            case ContainerState.STARTING:
                self._starting.setdefault(event.container, at)
            case ContainerState.RUNNING:
                self._running.setdefault(event.container, at)

    def node(self, row: int, at: float, event: NodeStateChanged) -> None:
        """Take a change of a node's state; what follows its first arrival changes nothing."""
        arrival = self.arrivals.get(row)
        if arrival is None:
            arrival = self.arrivals[row] = Arrival(row)
        if arrival.result:
            return
        if event.state is NodeState.REQUESTED:
            arrival.requested = at
        elif event.state is NodeState.LOADING and arrival.constructing is None:
            arrival.constructing = at
        elif event.state in _ENDS:
            arrival.end, arrival.result = at, _ENDS[event.state]
            arrival.starting = self._starting.get(event.container)
            arrival.running = self._running.get(event.container)

    def came_up(self) -> float | None:
        """Give when the last node had arrived, well or not; None when one never did."""
        ends = [each.end for each in self.arrivals.values()]
        known = [end for end in ends if end is not None]
        return max(known) if known and len(known) == len(ends) else None

    def latest(self) -> list[Arrival]:
        """Give the nodes for which the system waited longest, those that never came first."""

        def end(arrival: Arrival) -> float:
            return float("inf") if arrival.end is None else arrival.end

        return sorted(self.arrivals.values(), key=end, reverse=True)[:MOST]
