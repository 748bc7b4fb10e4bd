"""What is reported about a process that we own."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, Final

import anyio

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

    @property
    def has_started(self) -> bool:
        """Whether there ever was a process."""
        return self._process is not None

    def started(self, process: ManagedProcess, restarts: int) -> None:
        """Report it; what follows is about this process."""
        self._process = process
        self.publish(ProcessEventKind.STARTED, restarts, command=process.argv)

    def exited(self, exit_: Exit, restarts: int, killed_because: str = "") -> None:
        """Report how it ended, and why if that was our doing."""
        self.publish(
            ProcessEventKind.EXITED,
            restarts,
            message=f"{killed_because}; {exit_}" if killed_because else str(exit_),
            exit_code=exit_.code,
            signal=exit_.signal,
        )

    def on_output(self, stream: Stream, lines: Sequence[Line]) -> None:
        """Publish what it wrote."""
        pid = self._process.pid if self._process is not None else 0
        self._publisher.publish_output(self._name, pid, stream, lines)

    def publish(
        self,
        kind: ProcessEventKind,
        restarts: int,
        *,
        message: str = "",
        exit_code: int = 0,
        signal: int = 0,
        command: tuple[str, ...] = (),
    ) -> None:
        """Report something about the latest process; ``restarts``: of its member so far."""
        self._publisher.publish(
            ProcessEvent(
                stamp_ns=self._publisher.stamp_ns(),
                kind=kind,
                name=self._name,
                pid=self._process.pid if self._process is not None else 0,
                start_time=self._process.start_time if self._process is not None else 0,
                exit_code=exit_code,
                signal=signal,
                restarts=restarts,
                message=message,
                command=command,
            )
        )

    async def gone(self, process: ManagedProcess) -> None:
        """Wait until nothing of an ended process is left; report it when that takes too long."""
        with anyio.move_on_after(GONE_LIMIT) as scope:
            await process.gone()
        if scope.cancelled_caught:
            _log.error(
                "%s (pid %d): %g s after its end, something of it is left",
                self._name,
                process.pid,
                GONE_LIMIT,
            )
