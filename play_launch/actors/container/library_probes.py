"""Loads the libraries of components in scratch processes, before a container gets them."""

from __future__ import annotations

import asyncio
import logging
import os
from collections import deque
from functools import partial
from typing import TYPE_CHECKING, Final

from msgspec import Struct, field

from play_launch.actors.ports import StartError
from play_launch.core.events import Stream
from play_launch.core.probe import Finding, overdue, read_probe

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from play_launch.actors.ports import Launcher, ManagedProcess
    from play_launch.actors.publisher import Publisher
    from play_launch.config.model import ComposableNodeConfig, ContainerConfig
    from play_launch.process.lines import Line

_log = logging.getLogger(__name__)


class ProbeLimits(Struct, frozen=True, kw_only=True):
    """Seconds."""

    report_interval: float = 10.0
    """Between two reports of a library that is still being loaded."""
    gone: float = 10.0
    """From the end of a scratch process to the end of its children and its output."""


PROBE_LIMITS: Final = ProbeLimits()


def default_places() -> int:
    """How many libraries are probed at the same time: loading one is CPU time and reading."""
    return max(2, os.cpu_count() or 1)


_LAST_LINES: Final = 100
"""Lines of a scratch process's stdout that are kept: its result is the last one, but for what the
library's own threads and exit handlers write."""


class _Output(Struct):
    """What one scratch process writes: its result is on stdout, all else goes to the recording."""

    publish: Callable[[Stream, Sequence[Line]], None]
    result: deque[str] = field(default_factory=partial(deque, maxlen=_LAST_LINES))

    def __call__(self, stream: Stream, lines: Sequence[Line]) -> None:
        if stream is Stream.STDOUT:
            self.result.extend(line.text for line in lines)
        else:
            self.publish(stream, lines)


class LibraryProbes:
    """Runs scratch processes, a bounded number at a time; one for all containers of a run."""

    def __init__(
        self,
        launcher: Launcher,
        publisher: Publisher,
        *,
        places: int | None = None,
        limits: ProbeLimits = PROBE_LIMITS,
    ) -> None:
        """Take what starts processes; ``places`` is `default_places` where it is None."""
        self._launcher = launcher
        self._publisher = publisher
        self._places = asyncio.Semaphore(places or default_places())
        self._limits = limits

    async def library_of(self, container: ContainerConfig, node: ComposableNodeConfig) -> str:
        """Name the library of a node, or else the component; what is equal is probed once."""
        found = await self._launcher.library_of(container, node)
        return found or f"{node.package} {node.plugin}"

    async def probe(self, container: ContainerConfig, node: ComposableNodeConfig) -> Finding | None:
        """Load the library of a node; None when that could not be tried.

        When this is cancelled, the scratch process is killed first.
        """
        async with self._places:
            output = _Output(
                lambda stream, lines: self._publisher.publish_output(
                    container.full_name, process.pid, stream, lines
                )
            )
            try:
                process = self._launcher.start_probe(container, node, output)
            except StartError as error:
                _log.warning("%s: its library is not probed: %s", node.declared_full_name, error)
                return None
            try:
                in_time = await self._wait(
                    process, node.declared_full_name, container.probe_timeout
                )
            finally:
                process.kill()
                await self._gone(process)
        if not in_time:
            return overdue(container.probe_timeout)
        exit_ = await process.wait()
        return read_probe(output.result, exit_code=exit_.code, signal=exit_.signal)

    async def _wait(self, process: ManagedProcess, name: str, limit: float) -> bool:
        """Wait for the end; False when it does not come within ``limit`` seconds."""
        loop = asyncio.get_running_loop()
        began = loop.time()
        left = limit
        while left > 0:
            try:
                async with asyncio.timeout(min(left, self._limits.report_interval)):
                    await process.wait()
            except TimeoutError:
                took = loop.time() - began
                left = limit - took
                _log.warning(
                    "%s: its library has been loading in a scratch process (pid %d) for %.0f s, "
                    "of at most %.0f s",
                    name,
                    process.pid,
                    took,
                    limit,
                )
            else:
                return True
        return False

    async def _gone(self, process: ManagedProcess) -> None:
        try:
            async with asyncio.timeout(self._limits.gone):
                await process.gone()
        except TimeoutError:
            _log.error("the scratch process %d does not end", process.pid)
