"""Serves the control socket of the running session."""

from __future__ import annotations

import asyncio
import json
import logging
import os
import time
from functools import partial
from typing import TYPE_CHECKING

from msgspec.structs import replace

from play_launch.container.cdr.layout import text_bytes
from play_launch.control.client import own_command
from play_launch.control.messages import Caller, SessionHello
from play_launch.control.operations import Changes, Operations
from play_launch.control.protocol import OperationError
from play_launch.control.server import serving
from play_launch.recording import topics
from play_launch.recording.facts import OURSELVES, package_version
from play_launch.recording.resolved_form import resolved_form

if TYPE_CHECKING:
    from collections.abc import Callable

    from play_launch.config.model import ReplayConfig
    from play_launch.control.config_watch import Watched
    from play_launch.control.feed import Feed
    from play_launch.control.registration import ControlSocket
    from play_launch.recording.recorder import Recorder
    from play_launch.recording.session import Session
    from play_launch.recording.topic_recorder import Snapshots
    from play_launch.runtime.publisher import Publisher
    from play_launch.runtime.system import System

_log = logging.getLogger(__name__)


async def serve_control(
    config: ReplayConfig,
    session: Session,
    system: System,
    *,
    control: ControlSocket,
    publisher: Publisher,
    feed: Feed,
    snapshots: Snapshots,
    hide_secrets: Callable[[ReplayConfig], None],
    adopt: Callable[[ReplayConfig], None],
    keeps_duration: bool,
    watched: Watched | None,
    operable: asyncio.Future[None],
) -> None:
    """Serve clients until this is cancelled; the run continues whatever fails here.

    ``hide_secrets`` is called with each configuration before it is applied, ``adopt`` with the
    configuration of the system after each change; ``keeps_duration`` is whether the duration comes
    from the command line; ``watched`` is applied when it changes; ``operable`` is set as soon as
    requests are served.
    """

    def begin(target: ReplayConfig, number: int) -> None:
        hide_secrets(target)
        _attach(session.recorder, target, number)

    changes = Changes(
        system,
        publisher,
        with_command_line=partial(_with_command_line, config, keeps_duration=keeps_duration),
        on_begin=begin,
        on_end=adopt,
    )
    operations = Operations(
        system,
        publisher,
        feed,
        snapshots=snapshots,
        environment={**os.environ, **config.environment},
        parameters_of=partial(session.recorder.latest, topics.PARAMETERS),
        changes=changes,
    )
    version = await asyncio.to_thread(package_version, OURSELVES)
    hello = SessionHello(
        version=version,
        pid=os.getpid(),
        name=config.name,
        session=session.id,
        folder=control.folder,
        started_ns=time.time_ns(),
    )
    try:
        async with serving(control, hello, operations):
            operable.set_result(None)
            if watched is not None:
                await _watch(watched, config, changes)
            await asyncio.Event().wait()
    except Exception:  # noqa: BLE001 - it is logged, and the run goes on
        _log.exception("the session can no longer be controlled")


async def _watch(watched: Watched, config: ReplayConfig, changes: Changes) -> None:
    from play_launch.control.config_watch import watch  # noqa: PLC0415 - only for this

    try:
        await watch(watched, config, partial(_apply, changes))
    except Exception:  # noqa: BLE001 - as above
        _log.exception("%s is no longer watched", watched.path)


async def _apply(changes: Changes, target: ReplayConfig) -> None:
    try:
        await changes.apply_own(target, Caller(os.getpid(), os.getuid(), own_command()))
    except OperationError as error:
        _log.warning(
            "%s is not applied: %s; it is applied at its next change", target.source, error
        )


def _with_command_line(
    config: ReplayConfig, target: ReplayConfig, *, keeps_duration: bool
) -> ReplayConfig:
    """Put into ``target`` what the command line of the session said, as it did into ``config``."""
    if keeps_duration:
        target = replace(target, duration=config.duration)
    folders = config.log_dir, target.log_dir
    if None not in folders and len({str(each and each.absolute()) for each in folders}) == 1:
        target = replace(target, log_dir=config.log_dir)  # one of them is a relative path
    return target


def _attach(recorder: Recorder, config: ReplayConfig, number: int) -> None:
    """Attach it as ``applied/<number>/...``: as it was given, its files, and resolved."""
    place = f"applied/{number}"
    yaml = "application/yaml"
    recorder.attach(f"{place}/config{config.source.suffix or '.yaml'}", yaml, config.text)
    for kind, files in (
        ("includes", config.included_files),
        ("parameters", config.parameter_files),
    ):
        for index, file in enumerate(files):
            recorder.attach(f"{place}/{kind}/{index}-{file.path.name}", yaml, file.text)
    resolved = json.dumps(resolved_form(config), ensure_ascii=False)
    recorder.attach(f"{place}/resolved_config.json", "application/json", text_bytes(resolved))
