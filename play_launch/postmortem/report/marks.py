"""What went wrong at a moment: the marks of the timeline."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from msgspec import Struct, field

from play_launch.postmortem.findings import Kind, is_crash
from play_launch.postmortem.incidents import Incidents
from play_launch.postmortem.report.text import shown
from play_launch.supervisor.events import (
    ComponentEvent,
    NodeState,
    NodeStateChanged,
    ProcessEvent,
    ProcessEventKind,
)

if TYPE_CHECKING:
    from play_launch.postmortem.incidents import Incident

MOST: Final = 5_000
"""Marks that a page has; further ones are counted."""
DEAF: Final = "did not stop"
_WORDS: Final = {
    Kind.CRASHED: "crashed",
    Kind.DIED: "died",
    Kind.LOAD_FAILED: "failed to load",
    Kind.DEAF: DEAF,
}


class Mark(Struct, frozen=True):
    """One failure; ``at`` is in milliseconds since the start."""

    row: int
    at: float
    what: str
    """``crashed``, ``failed to load``, ``died``, ``did not stop``, ``gave up``."""
    reason: str
    backtrace: tuple[str, ...] = ()


class Marks(Struct):
    """Failures in the order of time; which there are is decided as for the story."""

    marks: list[Mark] = field(default_factory=list)
    left_out: int = 0
    _incidents: Incidents = field(default_factory=lambda: Incidents(lambda _: None))

    def component(self, event: ComponentEvent) -> None:
        """Keep a backtrace for the change of state that follows."""
        self._incidents.component(event)

    def node(self, row: int, at: float, event: NodeStateChanged) -> Mark | None:
        """Give the mark that a change of a node's state means, if any."""
        self._incidents.node(event, 0)
        if event.state is NodeState.GAVE_UP:
            return self._add(Mark(row, at, "gave up", shown(event.reason)))
        return self._failed(row, at, event.reason, self._incidents.latest)

    def process(self, row: int, at: float, event: ProcessEvent) -> Mark | None:
        """Give the mark that a step of a process means, if any; a wanted end has no mark."""
        self._incidents.process(event, 0)
        if event.kind is ProcessEventKind.GAVE_UP:
            return self._add(Mark(row, at, "gave up", shown(event.message)))
        return self._failed(row, at, event.message, self._incidents.latest)

    def _failed(self, row: int, at: float, reason: str, incident: Incident | None) -> Mark | None:
        if incident is None or incident.kind not in _WORDS:
            return None
        is_of_a_node = incident.kind is not Kind.DIED
        has_crashed = is_of_a_node and is_crash(incident.kind, incident.signature)
        what = _WORDS[Kind.CRASHED if has_crashed else incident.kind]
        trace = tuple(shown(frame.text) for frame in incident.frames)
        return self._add(Mark(row, at, what, shown(reason), trace))

    def _add(self, mark: Mark) -> Mark | None:
        if len(self.marks) >= MOST:
            self.left_out += 1
            return None
        self.marks.append(mark)
        return mark
