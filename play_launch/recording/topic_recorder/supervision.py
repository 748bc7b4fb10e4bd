"""Runs the program `topic_recorder` for as long as a system runs, and passes on what it makes."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import logging
import math
import os
import socket
from functools import partial
from typing import TYPE_CHECKING, Final

from play_launch.container.environment import child_environment
from play_launch.container.ros import (
    MixedInstallationError,
    NotInstalledError,
    ros_installation,
    spawn_guard,
    topic_recorder,
)
from play_launch.process.child import INHERITED, spawn
from play_launch.process.companion import keep_running
from play_launch.process.guard import SessionGuard, SpawnError
from play_launch.recording.topic_recorder import SnapshotError, WrittenBuffer
from play_launch.recording.topic_recorder import link as wire
from play_launch.ros.fastdds.middleware import asks_for_fastdds
from play_launch.ros.fastdds.shared_memory import sweep_shared_memory
from play_launch.supervisor.expectations import Measured

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from play_launch.config.model import ReplayConfig
    from play_launch.process.child import Child
    from play_launch.process.lines import Line
    from play_launch.recording.recorder import Recorder
    from play_launch.supervisor.events import Stream


_LONGEST_END: Final = 6.0
"""Seconds it has at the end to pass on the rest; it takes at most 5 itself."""
_SILENCE: Final = 5.0
"""Seconds without a measurement, of which there is one a second."""
_LONGEST_SNAPSHOT: Final = 25.0
"""Seconds in which what is held has to be written."""
_log = logging.getLogger(__name__)


class TopicRecording:
    """Starts the program, passes on what it makes, and restarts it if it dies.

    Belongs to the thread of the event loop.
    """

    def __init__(
        self,
        config: ReplayConfig,
        recorder: Recorder,
        on_measured: Callable[[Measured], None],
        on_silence: Callable[[str], None],
    ) -> None:
        """Prepare; `on_silence` is called when nothing measures topics, with the reason."""
        self._config = config
        self._on_measured = on_measured
        self._on_silence = on_silence
        self._silence: asyncio.TimerHandle | None = None
        self._recorder = recorder
        self._program: Path | None = None
        self._guard: SessionGuard | None = None
        """It ends the program with us, also when we are killed."""
        self._environment: Mapping[str, str] = {}
        self._child: Child | None = None
        self._link: wire.RecorderLink | None = None
        self._loop = asyncio.get_running_loop()
        self._numbers = itertools.count(1)
        self._awaited: dict[int, asyncio.Future[WrittenBuffer]] = {}

    async def run(self) -> None:
        """Record until it is cancelled; then the rest is passed on, and nothing is left running.

        What fails is logged as a warning. Returns when it cannot go on.
        """
        try:
            await asyncio.to_thread(self._prepare)
        except (NotInstalledError, MixedInstallationError, OSError) as error:
            _log.warning("topics of ROS are not recorded: %s", error)
            return
        try:
            await keep_running("topics of ROS are not recorded", self._live)
        finally:
            await self._end()
            if self._guard is not None:
                await self._guard.end()
            await self._sweep()

    async def take(self, reason: str) -> WrittenBuffer:
        """Have what is held written; ``reason`` is for the log. Raises SnapshotError."""
        if self._link is None:
            raise SnapshotError("nothing is held, as topics of ROS are not being recorded")
        number = next(self._numbers)
        awaited: asyncio.Future[WrittenBuffer] = asyncio.get_running_loop().create_future()
        self._awaited[number] = awaited
        drops = self._recorder.topic_drops
        self._link.send(wire.packet(wire.Kind.TAKE, number))
        try:
            async with asyncio.timeout(_LONGEST_SNAPSHOT):
                snapshot = await awaited
        except TimeoutError:
            raise SnapshotError("what is held was not written in time") from None
        finally:
            del self._awaited[number]
        if lost := self._recorder.topic_drops - drops:
            raise SnapshotError(f"{lost} messages of topics were dropped meanwhile; see the log")
        if snapshot.messages:
            _log.info(
                "%s: recorded %d messages (%.1f MB) of the %.1f s before",
                reason,
                snapshot.messages,
                snapshot.bytes / 1e6,
                snapshot.seconds,
            )
        return snapshot

    def _prepare(self) -> None:
        self._program = topic_recorder()
        environment = self._config.environment
        self._environment = child_environment(os.environ, ros_installation(), environment)
        self._guard = SessionGuard.start(spawn_guard())

    async def _start(self) -> tuple[Child, wire.RecorderLink]:
        assert self._program is not None
        assert self._guard is not None
        offset_ns = self._recorder.clock.offset_ns
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            try:
                child = await spawn(
                    recorder_argv(self._program, self._config, INHERITED, offset_ns),
                    env=self._environment,
                    guard=self._guard,
                    descriptors={INHERITED: theirs.fileno()},
                    on_output=_on_output,
                    leaves_by_itself=True,
                )
            except BaseException:
                ours.close()
                raise
        return child, wire.RecorderLink(ours, self._on_packet)

    async def _sweep(self) -> None:
        """Remove what other participants left that died while ours held it, and ours if killed."""
        if not asks_for_fastdds({**os.environ, **self._config.environment}):
            return
        try:
            await sweep_shared_memory()
        except OSError as error:
            _log.warning("shared memory was not cleaned up: %s", error)

    async def _live(self) -> str:
        """Run it once; the reason why it has ended."""
        reason = await self._reason_of_end()
        self._measured_again(None)
        self._on_silence(f"not measured: {reason}")
        return reason

    async def _reason_of_end(self) -> str:
        try:
            self._child, self._link = await self._start()
        except (SpawnError, OSError) as error:
            return str(error)
        ended = await self._child.gone()
        # What it has sent is still in the socket.
        await self._link.ended()
        self._link = None
        # Before the next one: publishers must have given up the ports that it takes over.
        await self._sweep()
        return f"topic_recorder {ended}"

    async def _end(self) -> None:
        self._measured_again(None)
        if self._child is None or self._link is None:
            return
        self._link.send(wire.packet(wire.Kind.STOP))
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(_LONGEST_END):
                await self._link.ended()
                await self._child.wait()
        self._child.kill()
        await self._child.gone()
        self._link.close()

    def _on_packet(self, packet: wire.Packet) -> None:
        assert self._link is not None
        link = self._link
        match packet:
            case wire.ChannelWanted():
                self._recorder.open_channel(
                    packet.topic,
                    packet.type_name,
                    packet.offered_qos_profiles,
                    lambda channel: link.send(wire.answer(packet.request, channel)),
                )
            case wire.ChunkMade():
                self._recorder.append_chunk(
                    packet.chunk, lambda: link.send(wire.packet(wire.Kind.DONE, packet.slot))
                )
            case wire.TopicDrops():
                self._count(packet)
            case wire.Warned():
                _log.warning("%s", packet.text)
            case Measured():
                self._measured_again(_SILENCE)
                self._on_measured(packet)
            case wire.SnapshotSent():
                self._recorder.after_these(partial(self._when_written, packet))

    def _measured_again(self, limit: float | None) -> None:
        """Await the next measurement for so many seconds; None: await none."""
        if self._silence is not None:
            self._silence.cancel()
        self._silence = None
        if limit is not None:
            reason = f"not measured for {limit:.0f} s: topic_recorder does not go on"
            self._silence = self._loop.call_later(limit, self._on_silence, reason)

    def _when_written(self, packet: wire.SnapshotSent) -> None:
        # In any thread.
        with contextlib.suppress(RuntimeError):  # the loop has ended
            self._loop.call_soon_threadsafe(self._written, packet)

    def _written(self, packet: wire.SnapshotSent) -> None:
        awaited = self._awaited.get(packet.number)
        if awaited is not None and not awaited.done():
            awaited.set_result(WrittenBuffer(packet.messages, packet.bytes, packet.span_ns / 1e9))

    def _count(self, drops: wire.TopicDrops) -> None:
        reasons = []
        if drops.over_budget:
            reasons.append(f"{drops.over_budget} exceed its budget")
        if drops.without_room:
            reasons.append(f"{drops.without_room} came faster than the disk takes them")
        _log.warning("messages of %s are not recorded: %s", drops.topic, ", ".join(reasons))
        self._recorder.count_topic_drops(drops.topic, drops.over_budget + drops.without_room)


def recorder_argv(
    program: Path, config: ReplayConfig, descriptor: int | str, clock_offset: int | str
) -> tuple[str, ...]:
    """Make the command line, with the socket's descriptor and the offset of the session's clock."""
    record = config.record
    measured = [part for topic in config.expect for part in ("--measure", topic)]
    argv = [os.fspath(program), "--socket", str(descriptor), "--clock-offset", str(clock_offset)]
    argv += measured
    if not record.ros:
        return (*argv, "--exclude", "*")
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


def _on_output(_stream: Stream, lines: Sequence[Line]) -> None:
    for line in lines:
        _log.warning("%s", line.text)
