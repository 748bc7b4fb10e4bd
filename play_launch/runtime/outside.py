"""External conditions: lines of output, files and the ROS graph that starts depend on."""

from __future__ import annotations

import asyncio
import os.path
import re
from typing import TYPE_CHECKING, Final

import anyio

from play_launch.config.dependency import ABOUT_GRAPH, Condition
from play_launch.supervisor.events import OutputLine
from play_launch.supervisor.inputs import FilesSeen, GraphSeen, LineSeen

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable

    from play_launch.config.dependency import Dependency, StartRule
    from play_launch.ros.access import RosAccess
    from play_launch.ros.graph_source import GraphSource
    from play_launch.supervisor.events import RunEvent
    from play_launch.supervisor.inputs import Input
    from play_launch.supervisor.view import SystemView

_FILE_POLL: Final = 0.1
"""Seconds between two checks of files that are waited for."""


class Outside:
    """Posts conditions that are met, as long as a unit waits for them; a sink for the lines.

    A line counts from when it was written; files and the graph count as they are now.
    """

    def __init__(self, post: Callable[[Input], None], ros: Callable[[], RosAccess]) -> None:
        """``ros`` is called when the graph is needed first."""
        self._post = post
        self._ros = ros
        self._graph: GraphSource | None = None
        self._dependencies: tuple[Dependency, ...] = ()
        self._watched: frozenset[tuple[Condition, str]] = frozenset()
        self._files: frozenset[str] = frozenset()
        self._found: frozenset[str] = frozenset()
        self._written: set[tuple[str, str]] = set()
        self._patterns: dict[str, dict[str, re.Pattern[str]]] = {}
        self._more_files = asyncio.Event()

    def expect(self, rules: Iterable[StartRule]) -> None:
        """Search output for the patterns of these rules, from now on."""
        self._patterns.clear()
        for rule in rules:
            for each in rule.dependencies:
                is_written = (each.unit, each.subject) in self._written
                if each.condition is Condition.LOG and not is_written:
                    patterns = self._patterns.setdefault(each.unit, {})
                    patterns[each.subject] = re.compile(each.subject)

    def watch(self, pending: tuple[Dependency, ...]) -> None:
        """Watch the conditions of these dependencies only."""
        if pending == self._dependencies:
            return
        self._dependencies = pending
        files = frozenset(each.subject for each in pending if each.condition is Condition.FILE)
        if files != self._files:
            self._files = files
            self._more_files.set()
        watched = frozenset(
            (each.condition, each.subject) for each in pending if each.condition in ABOUT_GRAPH
        )
        if watched != self._watched:
            self._watched = watched
            if self._graph is None:
                self._graph = self._ros().watch_graph(self._graph_changed)
            self._graph.watch(watched)

    async def run(self) -> None:
        """Check files as long as some are waited for."""
        while True:
            await self._more_files.wait()
            self._more_files.clear()
            while self._files:
                found = frozenset([path for path in self._files if await _exists(path)])
                if found != self._found:
                    self._found = found
                    self._post(FilesSeen(found))
                await anyio.sleep(_FILE_POLL)

    async def close(self) -> None:
        """Cancel all watches."""
        if self._graph is not None:
            await self._graph.close()

    def publish(self, event: RunEvent, _before: SystemView, _after: SystemView) -> None:
        """Search a line of output for the patterns."""
        if not isinstance(event, OutputLine) or event.process not in self._patterns:
            return
        patterns = self._patterns[event.process]
        found = [text for text, pattern in patterns.items() if pattern.search(event.text)]
        for text in found:
            del patterns[text]
            self._written.add((event.process, text))
        if not patterns:
            del self._patterns[event.process]
        for text in found:
            self._post(LineSeen(event.process, text))

    def _graph_changed(self, found: Collection[tuple[Condition, str]]) -> None:
        self._post(GraphSeen(frozenset(found)))


async def _exists(path: str) -> bool:
    """Whether a file can be seen; EACCES, EIO and the like count as no."""
    # A mount that does not answer must not hold up the stop.
    return await anyio.to_thread.run_sync(os.path.exists, path, abandon_on_cancel=True)
