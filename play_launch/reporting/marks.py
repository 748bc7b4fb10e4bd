"""What went wrong at a moment: the marks of the timeline."""

from __future__ import annotations

from collections import OrderedDict
from typing import Final

from msgspec import Struct, field

from play_launch.core.events import (
    ComponentEvent,
    ComponentEventKind,
    NodeState,
    NodeStateChanged,
    ProcessEvent,
    ProcessEventKind,
)
from play_launch.reporting.text import shown

MOST: Final = 5_000
"""Marks that a page has; further ones are counted."""
_UNCLAIMED: Final = 1_000
"""Backtraces that wait for the change of state that follows from them."""


class Mark(Struct, frozen=True):
    """One failure; ``at`` is in milliseconds since the start."""

    row: int
    at: float
    what: str
    """``crashed``, ``failed to load``, ``died``, ``gave up``."""
    reason: str
    backtrace: tuple[str, ...] = ()


class Marks(Struct):
    """Failures in the order of time, folded from events."""

    marks: list[Mark] = field(default_factory=list)
    left_out: int = 0
    _traces: OrderedDict[tuple[str, int], tuple[str, ...]] = field(default_factory=OrderedDict)
    _crashes: dict[int, int] = field(default_factory=dict)
    _stopping: set[int] = field(default_factory=set)

    def component(self, event: ComponentEvent) -> None:
        """Keep a backtrace for the change of state that follows."""
        if event.kind in {ComponentEventKind.CRASHED, ComponentEventKind.LOAD_FAILED}:
            self._traces[event.full_node_name, event.attempt] = event.backtrace
            if len(self._traces) > _UNCLAIMED:
                self._traces.popitem(last=False)

    def node(self, row: int, at: float, event: NodeStateChanged) -> Mark | None:
        """Give the mark that a change of a node's state means, if any."""
        crashed = event.crashes > self._crashes.get(row, 0)
        self._crashes[row] = event.crashes
        what = ""
        if crashed:
            what = "crashed"
        elif event.state is NodeState.LOAD_FAILED:
            what = "failed to load"
        elif event.state is NodeState.GAVE_UP:
            what = "gave up"
        if not what:
            return None
        trace = self._traces.pop((event.node, event.attempt), ())
        return self._add(Mark(row, at, what, shown(event.reason), tuple(map(shown, trace))))

    def process(self, row: int, at: float, event: ProcessEvent) -> Mark | None:
        """Give the mark that a step of a process means, if any; a wanted end is none."""
        match event.kind:
            case ProcessEventKind.STOPPING:
                self._stopping.add(row)
            case ProcessEventKind.STARTED:
                self._stopping.discard(row)
            case ProcessEventKind.GAVE_UP:
                return self._add(Mark(row, at, "gave up", shown(event.message)))
            case ProcessEventKind.EXITED if row not in self._stopping:
                if event.exit_code or event.signal:
                    return self._add(Mark(row, at, "died", shown(event.message)))
        return None

    def _add(self, mark: Mark) -> Mark | None:
        if len(self.marks) >= MOST:
            self.left_out += 1
            return None
        self.marks.append(mark)
        return mark
