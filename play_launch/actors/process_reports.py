"""What is told about a process that we own."""

from __future__ import annotations

import asyncio
import logging
from typing import TYPE_CHECKING, Final

from play_launch.core.events import ProcessEvent, ProcessEventKind

if TYPE_CHECKING:
    from collections.abc import Sequence

    from play_launch.actors.ports import ManagedProcess
    from play_launch.actors.publisher import Publisher
    from play_launch.core.events import Stream
    from play_launch.process.exit import Exit
    from play_launch.process.lines import Line

_log = logging.getLogger(__name__)

GONE_LIMIT: Final = 10.0
"""Seconds from the end of a process to the end of its children and its output."""


class ProcessReports:
    """Publishes the events of one container's or node's processes, one process after another."""

    def __init__(self, name: str, publisher: Publisher) -> None:
        """Take the full name."""
        self._name = name
        self._publisher = publisher
        self._process: ManagedProcess | None = None
        self.restarts = 0

    def started(self, process: ManagedProcess) -> None:
        """Tell it; what follows is about this process."""
        self._process = process
        self.publish(ProcessEventKind.STARTED, command=process.argv)

    def exited(self, exit_: Exit, killed_because: str = "") -> None:
        """Tell how it ended, and why if that was our doing."""
        self.publish(
            ProcessEventKind.EXITED,
            message=f"{killed_because}; {exit_}" if killed_because else str(exit_),
            exit_code=exit_.code,
            signal=exit_.signal,
        )

    def on_output(self, stream: Stream, lines: Sequence[Line]) -> None:
        """Tell what it wrote."""
        pid = self._process.pid if self._process is not None else 0
        self._publisher.publish_output(self._name, pid, stream, lines)

    def publish(
        self,
        kind: ProcessEventKind,
        *,
        message: str = "",
        exit_code: int = 0,
        signal: int = 0,
        command: tuple[str, ...] = (),
    ) -> None:
        """Tell something about the latest process."""
        self._publisher.publish(
            ProcessEvent(
                stamp_ns=self._publisher.stamp_ns(),
                kind=kind,
                name=self._name,
                pid=self._process.pid if self._process is not None else 0,
                start_time=self._process.start_time if self._process is not None else 0,
                exit_code=exit_code,
                signal=signal,
                restarts=self.restarts,
                message=message,
                command=command,
            )
        )

    async def gone(self, process: ManagedProcess) -> None:
        """Wait until nothing of an ended process is left, and complain if that takes too long."""
        try:
            async with asyncio.timeout(GONE_LIMIT):
                await process.gone()
        except TimeoutError:
            _log.exception("%s (pid %d): something of it is left", self._name, process.pid)
