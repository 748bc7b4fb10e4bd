"""How long publishers and subscriptions of a recorded graph did not connect."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Final, NamedTuple

from play_launch.supervisor.endpoints import Mismatch, connections
from play_launch.supervisor.events import ProcessEventKind

if TYPE_CHECKING:
    from collections.abc import Iterator

    from play_launch.supervisor.endpoints import Endpoint, TopicConnections
    from play_launch.supervisor.events import GraphChanged, ProcessEvent

_LASTING: Final = 5_000_000_000
"""Nanoseconds; what lasts shorter is discovery, a reload, or the end."""
_ENDS: Final = frozenset({ProcessEventKind.STOPPING, ProcessEventKind.EXITED})
_MOST: Final = 1_000
"""Lacks and mismatches that are kept."""


class Lack(NamedTuple):
    """A topic with subscriptions and no publisher, or the reverse."""

    topic: str
    of_publisher: bool
    begin_ns: int
    end_ns: int
    """0: until the end."""
    before: tuple[str, ...]
    """Nodes that it had on that side; empty: never any."""
    others: tuple[str, ...]
    """Nodes that it had on the other side."""


_Problem = tuple[str, bool] | Mismatch


class Connections:
    """The connections of the graph, as far as it was recorded, while the system runs."""

    def __init__(self) -> None:
        self.lacks: list[Lack] = []
        self.mismatches: dict[Mismatch, int] = {}
        """Those that lasted, and since when."""
        self._topics: dict[str, Counter[Endpoint]] = {}
        self._since: dict[str, dict[_Problem, int]] = {}
        """By topic."""
        self._last: dict[tuple[str, bool], tuple[str, ...]] = {}
        """Nodes that a topic had on a side when it had some there."""
        self._running: set[str] = set()
        self._stopped_ns = 0
        """Since when no process runs that is not being stopped."""
        self._later: list[GraphChanged] = []
        """What changed since then: it counts if a process is started again."""

    @property
    def endpoints(self) -> Iterator[Endpoint]:
        """Those at the end."""
        return (each for every in self._topics.values() for each in every)

    def run(self, event: ProcessEvent) -> None:
        if event.kind in _ENDS:
            self._running.discard(event.name)
            if not self._running:
                self._stopped_ns = self._stopped_ns or event.stamp_ns
        elif event.kind is ProcessEventKind.STARTED:
            self._running.add(event.name)
            self._stopped_ns, later, self._later = 0, self._later, []
            for change in later:
                self.take(change)

    def take(self, event: GraphChanged) -> None:
        if self._stopped_ns:
            self._later.append(event)
            return
        changed = (*event.endpoints_appeared, *event.endpoints_vanished)
        for each in event.endpoints_appeared:
            self._topics.setdefault(each.topic, Counter())[each] += 1
        for each in event.endpoints_vanished:
            # Minus: what was not recorded is not there.
            self._topics[each.topic] = self._topics.get(each.topic, Counter()) - Counter([each])
        for topic in dict.fromkeys(each.topic for each in changed):
            every = connections(self._topics[topic])
            found = [problem for now in every for problem in self._problems(now)]
            since = self._since.pop(topic, {})
            self._since[topic] = {each: since.pop(each, event.stamp_ns) for each in found}
            for problem, begin_ns in since.items():
                self._end(problem, begin_ns, event.stamp_ns, event.stamp_ns)

    def end(self, at_ns: int) -> None:
        """Finish: what is lacking was lacking until the end."""
        for since in self._since.values():
            for problem, begin_ns in since.items():
                self._end(problem, begin_ns, self._stopped_ns or at_ns, 0)

    def _problems(self, now: TopicConnections) -> Iterator[_Problem]:
        yield from now.mismatches
        for of_publisher, nodes in ((True, now.publishers), (False, now.subscribers)):
            if nodes:
                self._last[now.topic, of_publisher] = nodes
        if now.subscribers and not now.has_publisher:
            yield now.topic, True
        if now.publishers and not now.subscribers and (now.topic, False) in self._last:
            yield now.topic, False

    def _end(self, problem: _Problem, begin_ns: int, at_ns: int, end_ns: int) -> None:
        if at_ns - begin_ns < _LASTING or len(self.lacks) + len(self.mismatches) >= _MOST:
            return
        if isinstance(problem, Mismatch):
            self.mismatches.setdefault(problem, begin_ns)
            return
        topic, of_publisher = problem
        before = self._last.get((topic, of_publisher), ())
        others = self._last.get((topic, not of_publisher), ())
        self.lacks.append(Lack(topic, of_publisher, begin_ns, end_ns, before, others))
