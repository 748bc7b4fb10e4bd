"""The program `topic_recorder`: its command line, and one run of it."""

from __future__ import annotations

import logging
import math
import os
import socket
from typing import TYPE_CHECKING

from play_launch.container.environment import child_environment
from play_launch.container.ros import ros_installation, spawn_guard, topic_recorder
from play_launch.process.child import INHERITED, spawn
from play_launch.process.guard import SessionGuard
from play_launch.recording.topic_recorder.link import RecorderLink

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from play_launch.config.model import RecordConfig
    from play_launch.process.child import Child
    from play_launch.process.lines import Line
    from play_launch.recording.clock import SessionClock
    from play_launch.recording.topic_recorder.packets import Packet
    from play_launch.supervisor.events import Stream

_log = logging.getLogger(__name__)


def recorder_argv(program: Path, record: RecordConfig, descriptor: int | str) -> tuple[str, ...]:
    """Make the command line; ``descriptor`` is that of the socket, or what stands for it."""
    argv = [os.fspath(program), "--socket", str(descriptor)]
    for option, patterns in (("--topic", record.topics), ("--exclude", record.exclude)):
        argv += [part for pattern in patterns for part in (option, pattern)]
    if record.budget is not None:
        argv += ["--budget", str(record.budget)]
    for pattern, size in record.topic_budgets:
        argv += ["--topic-budget", f"{pattern}={size if math.isfinite(size) else 0:.0f}"]
    if record.before_crash is not None:
        held = record.before_crash
        argv += [part for pattern in held.topics for part in ("--held", pattern)]
        argv += ["--hold-time", str(round(held.seconds * 1e9))]
        argv += ["--hold-size", str(held.megabytes * 1_000_000)]
    return tuple(argv)


class Program:
    """Starts the program, again and again if need be, under a guard of its own.

    The guard ends it with us, also when we are killed.
    """

    def __init__(
        self, record: RecordConfig, environment: Mapping[str, str], clock: SessionClock
    ) -> None:
        """Find it; ``environment`` is what the configuration declares. Raises NotInstalledError."""
        self._clock = clock
        self._program = topic_recorder()
        self._record = record
        self._environment = child_environment(os.environ, ros_installation(), environment)
        self._guard = SessionGuard.start(spawn_guard())

    async def start(self, on_packet: Callable[[Packet], None]) -> tuple[Child, RecorderLink]:
        """Start it; raises SpawnError, OSError."""
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            try:
                child = await spawn(
                    (
                        *recorder_argv(self._program, self._record, INHERITED),
                        *("--clock-offset", str(self._clock.offset_ns)),
                    ),
                    env=self._environment,
                    guard=self._guard,
                    descriptors={INHERITED: theirs.fileno()},
                    on_output=_on_output,
                    leaves_by_itself=True,
                )
            except BaseException:
                ours.close()
                raise
        return child, RecorderLink(ours, on_packet)

    async def close(self) -> None:
        """End what is left."""
        await self._guard.end()


def _on_output(_stream: Stream, lines: Sequence[Line]) -> None:
    for line in lines:
        _log.warning("%s", line.text)
