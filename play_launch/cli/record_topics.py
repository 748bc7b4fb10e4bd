"""The recording of ROS's topics beside a run. What does it is imported when that is up."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from typing import TYPE_CHECKING, Final

from play_launch.supervisor.view import is_up

if TYPE_CHECKING:
    from play_launch.config.model import ReplayConfig
    from play_launch.recording.session import Session
    from play_launch.recording.topic_recorder.session import FailureWatch
    from play_launch.recording.topic_recorder.snapshot import Snapshots
    from play_launch.runtime.publisher import Publisher, StopRequests
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
    from play_launch.recording.topic_recorder import session as topic_session  # noqa: PLC0415

    def see_failures(watch: FailureWatch) -> None:
        publisher.add_sink(_UntilStop(watch, stop))

    requests = session.recorder
    try:
        await topic_session.record_topics(config, requests, snapshots, on_begin=see_failures)
    except Exception:  # noqa: BLE001 - the run must go on whatever fails here
        _log.exception("topics of ROS are not recorded")


class _UntilStop:
    """Hides from a watch how processes end when they are stopped."""

    def __init__(self, watch: FailureWatch, stop: StopRequests) -> None:
        self._watch = watch
        self._stop = stop

    def publish(self, event: RunEvent, before: SystemView, after: SystemView) -> None:
        if not self._stop.requested.is_set():
            self._watch.publish(event, before, after)
