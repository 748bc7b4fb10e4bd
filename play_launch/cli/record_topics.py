"""Records topics of ROS beside a run; the recording itself is imported when that is up."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from functools import partial
from typing import TYPE_CHECKING, Final

from play_launch.recording.forms import is_failure
from play_launch.recording.topic_recorder import SnapshotError
from play_launch.supervisor.events import (
    ComponentEvent,
    ContainerStateChanged,
    NodeStateChanged,
    ProcessEvent,
)
from play_launch.supervisor.view import is_up

if TYPE_CHECKING:
    from play_launch.config.model import ReplayConfig
    from play_launch.recording.session import Session
    from play_launch.recording.topic_recorder import Snapshots
    from play_launch.recording.topic_recorder.supervision import TopicRecording
    from play_launch.runtime.publisher import Publisher
    from play_launch.runtime.signals import StopRequests
    from play_launch.supervisor.events import RunEvent
    from play_launch.supervisor.view import SystemView

LATEST_START: Final = 3.0
"""Seconds after which it begins even though nodes are still being loaded."""
_LOOK: Final = 0.1
_log = logging.getLogger(__name__)


async def record_topics(
    config: ReplayConfig,
    session: Session,
    publisher: Publisher,
    stop: StopRequests,
    *,
    snapshots: Snapshots,
) -> None:
    """Record topics from when the system is up until this is cancelled; the run goes on anyway."""
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(LATEST_START):
            # A look now and then takes less of the start than one at each event.
            while not is_up(publisher.view):  # noqa: ASYNC110
                await asyncio.sleep(_LOOK)
    from play_launch.recording.topic_recorder.supervision import TopicRecording  # noqa: PLC0415

    recording = TopicRecording(config, session.recorder)
    try:
        if config.record.before_crash is None:
            await recording.run()
            return
        watch = FailureWatch(recording, stop)
        publisher.add_sink(watch)
        with snapshots.taken_by(partial(recording.take, "snapshot")):
            async with asyncio.TaskGroup() as tasks:
                watching = tasks.create_task(watch.run())
                try:
                    await recording.run()
                finally:
                    watching.cancel()
    except Exception:  # noqa: BLE001 - the run must go on whatever fails here
        _log.exception("topics of ROS are not recorded")


class FailureWatch:
    """Writes the pre-crash buffer when something fails, but for processes that are stopped."""

    def __init__(self, recording: TopicRecording, stop: StopRequests) -> None:
        self._recording = recording
        self._stop = stop
        self._failed = asyncio.Event()
        self._reason = ""

    def publish(self, event: RunEvent, before: SystemView, after: SystemView) -> None:  # noqa: ARG002 - a sink
        if self._stop.requested.is_set() or self._failed.is_set() or not is_failure(event):
            return
        match event:
            case ComponentEvent():
                name = event.full_node_name or event.plugin_name
            case ProcessEvent():
                name = event.name
            case NodeStateChanged():
                name = event.node
            case ContainerStateChanged():
                name = event.container
            case _:
                return
        self._reason = f"{name} failed"
        self._failed.set()

    async def run(self) -> None:
        """Take snapshots until this is cancelled."""
        while True:
            await self._failed.wait()
            self._failed.clear()
            with contextlib.suppress(SnapshotError):  # it was reported why nothing is recorded
                await self._recording.take(self._reason)
