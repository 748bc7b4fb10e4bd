"""What holds outside of the members: lines that were written, files, the ROS graph."""

from __future__ import annotations

import asyncio
import os.path
import re
from collections.abc import Callable, Collection
from typing import TYPE_CHECKING, Final, Protocol

import anyio

from play_launch.core.dependency import ABOUT_GRAPH, Condition
from play_launch.core.events import OutputLine

if TYPE_CHECKING:
    from collections.abc import Iterable

    from play_launch.core.dependency import Dependency, StartRule
    from play_launch.core.events import RunEvent
    from play_launch.core.view import SystemView

OnGraphChange = Callable[[Collection[tuple[Condition, str]]], None]
"""Gets what is there of what is watched: NODE, TOPIC or SERVICE, with a full name."""

_FILE_POLL: Final = 0.1
"""Seconds between two looks at files that somebody waits for."""


class Graph(Protocol):
    """A view of the ROS graph, see :mod:`play_launch.ros.graph_source`."""

    def watch(self, wanted: Iterable[tuple[Condition, str]]) -> None:
        """Watch these, and no others."""

    async def close(self) -> None:
        """End it."""


class World:
    """Collects facts as long as somebody waits for them; a sink of events for the lines.

    A line that was written stays written; files and the graph are as they are now.
    """

    def __init__(
        self,
        on_change: Callable[[], None],
        watch_graph: Callable[[OnGraphChange], Graph],
    ) -> None:
        """Take who hears of changes; ``watch_graph`` is called when the graph is needed first."""
        self._on_change = on_change
        self._watch_graph = watch_graph
        self._graph: Graph | None = None
        self._watched: frozenset[tuple[Condition, str]] = frozenset()
        self._in_graph: Collection[tuple[Condition, str]] = frozenset()
        self._files: set[str] = set()
        self._awaited_files: frozenset[str] = frozenset()
        self._written: set[tuple[str, str]] = set()
        self._patterns: dict[str, dict[str, re.Pattern[str]]] = {}
        self._more_files = asyncio.Event()

    def expect(self, rules: Iterable[StartRule]) -> None:
        """Take which lines may be waited for from now on."""
        self._patterns.clear()
        for rule in rules:
            for each in rule.dependencies:
                is_written = (each.unit, each.subject) in self._written
                if each.condition is Condition.LOG and not is_written:
                    patterns = self._patterns.setdefault(each.unit, {})
                    patterns[each.subject] = re.compile(each.subject)

    def holds(self, dependency: Dependency) -> bool:
        """Whether a condition of the kinds that this knows holds."""
        match dependency.condition:
            case Condition.LOG:
                return (dependency.unit, dependency.subject) in self._written
            case Condition.FILE:
                return dependency.subject in self._files
            case condition:
                return (condition, dependency.subject) in self._in_graph

    def watch(self, missing: Iterable[Dependency]) -> None:
        """Look after these from now on."""
        missing = tuple(missing)
        files = frozenset(each.subject for each in missing if each.condition is Condition.FILE)
        if files != self._awaited_files:
            self._awaited_files = files
            self._more_files.set()
        watched = frozenset(
            (each.condition, each.subject) for each in missing if each.condition in ABOUT_GRAPH
        )
        if watched != self._watched:
            self._watched = watched
            if self._graph is None:
                self._graph = self._watch_graph(self._graph_changed)
            self._graph.watch(watched)

    async def run(self) -> None:
        """Look at files as long as somebody waits for some."""
        while True:
            await self._more_files.wait()
            self._more_files.clear()
            while self._awaited_files:
                found = {path for path in self._awaited_files if await _exists(path)}
                if found != self._files:
                    self._files = found
                    self._on_change()
                await anyio.sleep(_FILE_POLL)

    async def close(self) -> None:
        """Look at nothing any more."""
        if self._graph is not None:
            await self._graph.close()

    def publish(self, event: RunEvent, _before: SystemView, _after: SystemView) -> None:
        """Look for the patterns in what is written."""
        if not isinstance(event, OutputLine) or event.process not in self._patterns:
            return
        patterns = self._patterns[event.process]
        found = [text for text, pattern in patterns.items() if pattern.search(event.text)]
        for text in found:
            del patterns[text]
            self._written.add((event.process, text))
        if not patterns:
            del self._patterns[event.process]
        if found:
            self._on_change()

    def _graph_changed(self, found: Collection[tuple[Condition, str]]) -> None:
        if found != self._in_graph:
            self._in_graph = found
            self._on_change()


async def _exists(path: str) -> bool:
    """Whether a file can be seen; EACCES, EIO and the like count as no."""
    # A mount that does not answer must not hold up the stop.
    return await anyio.to_thread.run_sync(os.path.exists, path, abandon_on_cancel=True)
