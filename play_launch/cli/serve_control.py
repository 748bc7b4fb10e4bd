"""Has a running session operated from outside, by the commands and by other programs."""

from __future__ import annotations

import asyncio
import logging
import os
import time
from functools import partial
from typing import TYPE_CHECKING

from play_launch.cli.applied_config import as_started, attach_applied
from play_launch.control.changes import Changes
from play_launch.control.client import own_command
from play_launch.control.operations import Operations
from play_launch.control.parameter_names import ParameterNames
from play_launch.control.place import Peer
from play_launch.control.protocol import ControlError
from play_launch.control.server import About, serving
from play_launch.recording import topics
from play_launch.recording.versions import OURSELVES, installed_versions

if TYPE_CHECKING:
    from collections.abc import Callable

    from play_launch.cli.watch import Watched
    from play_launch.config.model import ReplayConfig
    from play_launch.control.door import Door
    from play_launch.control.feed import Feed
    from play_launch.recording.session import Session
    from play_launch.recording.topic_recorder.snapshot import Snapshots
    from play_launch.runtime.publisher import Publisher
    from play_launch.runtime.system import System

_log = logging.getLogger(__name__)


async def serve_control(
    config: ReplayConfig,
    session: Session,
    system: System,
    *,
    door: Door,
    publisher: Publisher,
    feed: Feed,
    snapshots: Snapshots,
    hide_secrets: Callable[[ReplayConfig], None],
    adopt: Callable[[ReplayConfig], None],
    keeps_duration: bool,
    watched: Watched | None,
    operable: asyncio.Future[None],
) -> None:
    """Answer until this is cancelled; the run goes on whatever fails here.

    ``hide_secrets`` hears of each configuration before it is applied; ``adopt`` of what the system
    is configured as, each time that this has changed;
    ``keeps_duration`` is whether the command line said it; ``watched`` is applied when it changes;
    ``operable`` becomes done as soon as commands are answered.
    """
    operations = Operations(
        system,
        publisher,
        feed,
        snapshots=snapshots,
        environment={**os.environ, **config.environment},
    )

    def begin(target: ReplayConfig, number: int) -> None:
        hide_secrets(target)
        attach_applied(session.recorder.topic_requests, target, number)

    changes = Changes(
        system,
        operations.records,
        as_started=partial(as_started, config, keeps_duration=keeps_duration),
        on_begin=begin,
        on_end=adopt,
    )
    names = ParameterNames(
        system, operations.chosen, partial(session.recorder.latest, topics.PARAMETERS)
    )
    operations.add("parameters", names.give)
    operations.add("diff", changes.diff)
    operations.add("apply", changes.apply)
    versions = await asyncio.to_thread(installed_versions, [OURSELVES])
    about = About(
        name=config.name,
        session=session.id,
        version=versions.get(OURSELVES, ""),
        started_ns=time.time_ns(),
    )
    try:
        async with serving(door, about, operations):
            operable.set_result(None)
            if watched is not None:
                await _watch(watched, config, changes)
            await asyncio.Event().wait()
    except Exception:  # noqa: BLE001 - it is logged, and the run goes on
        _log.exception("the session cannot be controlled any more")


async def _watch(watched: Watched, config: ReplayConfig, changes: Changes) -> None:
    from play_launch.cli.watch import watch  # noqa: PLC0415 - only for this

    try:
        await watch(watched, config, partial(_apply, changes))
    except Exception:  # noqa: BLE001 - as above
        _log.exception("%s is not watched any more", watched.path)


async def _apply(changes: Changes, target: ReplayConfig) -> None:
    try:
        us = Peer(os.getpid(), os.getuid(), os.getgid(), own_command())
        await changes.apply_own(target, us)
    except ControlError as error:
        _log.warning("%s is not applied: %s; it is when it changes again", target.source, error)
