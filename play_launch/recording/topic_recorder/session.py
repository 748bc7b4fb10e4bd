"""The recording of topics as a part of a run: with failures and requests that ask for snapshots."""

from __future__ import annotations

import asyncio
import contextlib
from typing import TYPE_CHECKING

from play_launch.recording.forms import is_failure
from play_launch.recording.topic_recorder.snapshot import SnapshotError
from play_launch.recording.topic_recorder.supervision import TopicRecording
from play_launch.supervisor.events import (
    ComponentEvent,
    ContainerStateChanged,
    NodeStateChanged,
    ProcessEvent,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from play_launch.config.model import ReplayConfig
    from play_launch.recording.recorder import Recorder
    from play_launch.recording.topic_recorder.snapshot import Snapshot, Snapshots
    from play_launch.supervisor.events import RunEvent
    from play_launch.supervisor.view import SystemView


async def record_topics(
    config: ReplayConfig,
    sink: Recorder,
    snapshots: Snapshots,
    *,
    on_begin: Callable[[FailureWatch], None],
) -> None:
    """Record until this is cancelled.

    Args:
        config: Selects what is recorded.
        sink: Takes it.
        snapshots: Where they are asked for.
        on_begin: Gets what is to see the events of the run, where topics are held.
    """
    recording = TopicRecording(config, sink)
    if config.record.before_crash is None:
        await recording.run()
        return
    watch = FailureWatch(recording)
    on_begin(watch)

    async def asked() -> Snapshot:
        return await recording.take("snapshot")

    with snapshots.taken_by(asked):
        async with asyncio.TaskGroup() as tasks:
            watching = tasks.create_task(watch.run())
            try:
                await recording.run()
            finally:
                watching.cancel()


class FailureWatch:
    """Has what is held written when something fails."""

    def __init__(self, recording: TopicRecording) -> None:
        """Take snapshots of a recording."""
        self._recording = recording
        self._failed = asyncio.Event()
        self._reason = ""

    def publish(self, event: RunEvent, before: SystemView, after: SystemView) -> None:  # noqa: ARG002 - a sink
        """See an event."""
        match event:
            case ComponentEvent() if is_failure(event):
                self._note(f"{event.full_node_name or event.plugin_name} failed")
            case ProcessEvent() if is_failure(event):
                self._note(f"{event.name} failed")
            case NodeStateChanged() if is_failure(event):
                self._note(f"{event.node} failed")
            case ContainerStateChanged() if is_failure(event):
                self._note(f"{event.container} failed")
            case _:
                pass

    async def run(self) -> None:
        """Take snapshots until this is cancelled."""
        while True:
            await self._failed.wait()
            self._failed.clear()
            with contextlib.suppress(SnapshotError):  # it was reported why nothing is recorded
                await self._recording.take(self._reason)

    def _note(self, reason: str) -> None:
        if not self._failed.is_set():
            self._reason = reason
            self._failed.set()
