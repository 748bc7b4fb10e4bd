"""Has topics recorded for as long as a system runs."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import logging
import os
import random
import signal
from functools import partial
from typing import TYPE_CHECKING, Final

from play_launch.config.model import RestartLimits
from play_launch.container.ros import MixedInstallationError, NotInstalledError
from play_launch.process.program import SpawnError
from play_launch.recording.topic_recorder import packets
from play_launch.recording.topic_recorder.program import Program
from play_launch.recording.topic_recorder.snapshot import Snapshot, SnapshotError
from play_launch.ros.fastdds.middleware import asks_for_fastdds
from play_launch.ros.fastdds.shared_memory import sweep_shared_memory
from play_launch.supervisor.restart import Restart, RestartHistory, decide

if TYPE_CHECKING:
    from play_launch.config.model import ReplayConfig
    from play_launch.process.child import Child
    from play_launch.recording.recorder import Recorder
    from play_launch.recording.topic_recorder.link import RecorderLink


_RESTARTS: Final = RestartLimits(max_restarts=3, within=60.0, initial=0.5, maximum=8.0)
_LONGEST_END: Final = 6.0
"""Seconds it has at the end to pass on the rest; it takes at most 5 itself."""
_LONGEST_SNAPSHOT: Final = 25.0
"""Seconds in which what is held has to be written."""
_log = logging.getLogger(__name__)


class TopicRecording:
    """One session's: starts the program, passes on what it makes, starts it again if it dies.

    Belongs to the thread of the event loop.
    """

    def __init__(self, config: ReplayConfig, sink: Recorder) -> None:
        """Know what to do; nothing is started."""
        self._config = config
        self._sink = sink
        self._program: Program | None = None
        self._child: Child | None = None
        self._link: RecorderLink | None = None
        self._loop = asyncio.get_running_loop()
        self._numbers = itertools.count(1)
        self._awaited: dict[int, asyncio.Future[Snapshot]] = {}

    async def run(self) -> None:
        """Record until it is cancelled; then the rest is passed on, and nothing is left running.

        What fails is logged as a warning. Returns when it cannot go on.
        """
        try:
            self._program = await asyncio.to_thread(self._find)
        except (NotInstalledError, MixedInstallationError, OSError) as error:
            _log.warning("topics of ROS are not recorded: %s", error)
            return
        try:
            await self._keep_running()
        finally:
            await self._end()
            await self._program.close()
            await self._sweep()

    async def take(self, reason: str) -> Snapshot:
        """Have what is held written; ``reason`` is for the log. Raises SnapshotError."""
        if self._link is None:
            raise SnapshotError("nothing is held, as topics of ROS are not being recorded")
        number = next(self._numbers)
        awaited: asyncio.Future[Snapshot] = asyncio.get_running_loop().create_future()
        self._awaited[number] = awaited
        self._link.send(packets.take(number))
        try:
            async with asyncio.timeout(_LONGEST_SNAPSHOT):
                snapshot = await awaited
        except TimeoutError:
            raise SnapshotError("what is held was not written in time") from None
        finally:
            del self._awaited[number]
        if snapshot.messages:
            _log.info(
                "%s: recorded %d messages (%.1f MB) of the %.1f s before",
                reason,
                snapshot.messages,
                snapshot.bytes / 1e6,
                snapshot.seconds,
            )
        return snapshot

    def _find(self) -> Program:
        return Program(self._config.record, self._config.environment, self._sink.clock)

    async def _sweep(self) -> None:
        """Remove what other participants left that died while ours held it, and ours if killed."""
        if not asks_for_fastdds({**os.environ, **self._config.environment}):
            return
        try:
            await sweep_shared_memory()
        except OSError as error:
            _log.warning("shared memory was not cleaned up: %s", error)

    async def _keep_running(self) -> None:
        loop = asyncio.get_running_loop()
        history = RestartHistory()
        while True:
            began = loop.time()
            reason = await self._live()
            now = loop.time()
            jitter = random.random()  # noqa: S311 - spreads restarts
            history, decision = decide(
                history, _RESTARTS, now=now, lived=now - began, jitter=jitter
            )
            if not isinstance(decision, Restart):
                _log.warning(
                    "topics of ROS are not recorded any more: %s; %s", reason, decision.reason
                )
                return
            _log.warning(
                "topics of ROS are not recorded for %.1f s: %s; it is started again",
                decision.delay,
                reason,
            )
            await asyncio.sleep(decision.delay)

    async def _live(self) -> str:
        """Run it once; the reason why it has ended."""
        assert self._program is not None
        try:
            self._child, self._link = await self._program.start(self._on_packet)
        except (SpawnError, OSError) as error:
            return str(error)
        ended = await self._child.gone()
        # What it has sent is still in the socket.
        await self._link.ended()
        self._link = None
        return f"topic_recorder {ended}"

    async def _end(self) -> None:
        if self._child is None or self._link is None:
            return
        self._link.send(packets.stop())
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(_LONGEST_END):
                await self._link.ended()
                await self._child.wait()
        self._child.signal_group(signal.SIGKILL)
        await self._child.gone()
        self._link.close()

    def _on_packet(self, packet: packets.Packet) -> None:
        assert self._link is not None
        link = self._link
        match packet:
            case packets.ChannelWanted():
                self._sink.open_channel(
                    packet.topic,
                    packet.type_name,
                    packet.offered_qos_profiles,
                    lambda channel: link.send(packets.answer(packet.request, channel)),
                )
            case packets.ChunkMade():
                self._sink.append_chunk(packet.chunk, lambda: link.send(packets.done(packet.slot)))
            case packets.Drops():
                self._count(packet)
            case packets.Warned():
                _log.warning("%s", packet.text)
            case packets.HandedOver():
                self._sink.after_these(partial(self._when_written, packet))

    def _when_written(self, packet: packets.HandedOver) -> None:
        # In any thread.
        with contextlib.suppress(RuntimeError):  # the loop has ended
            self._loop.call_soon_threadsafe(self._written, packet)

    def _written(self, packet: packets.HandedOver) -> None:
        awaited = self._awaited.get(packet.number)
        if awaited is not None and not awaited.done():
            awaited.set_result(Snapshot(packet.messages, packet.bytes, packet.span_ns / 1e9))

    def _count(self, drops: packets.Drops) -> None:
        reasons = []
        if drops.over_budget:
            reasons.append(f"{drops.over_budget} exceed its budget")
        if drops.without_room:
            reasons.append(f"{drops.without_room} came faster than the disk takes them")
        _log.warning("messages of %s are not recorded: %s", drops.topic, ", ".join(reasons))
        self._sink.count_topic_drops(drops.topic, drops.over_budget + drops.without_room)
