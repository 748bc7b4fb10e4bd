"""Runs a system: recording, display and signals around ``run_system``."""

from __future__ import annotations

import asyncio
import contextlib
import gc
import json
import logging
import math
import os
import sys
from typing import TYPE_CHECKING, Final

from msgspec import Struct
from msgspec.structs import replace

from play_launch.cli.check import describe
from play_launch.cli.library_output import library_output_logged
from play_launch.cli.output import is_terminal, surviving_the_loss_of_stdout, wants_colour
from play_launch.cli.show.display import Display, Style
from play_launch.cli.show.group_totals import GroupTotals
from play_launch.cli.show.json_style import JsonStyle, encode
from play_launch.cli.show.text_styles import LiveStyle, PlainStyle
from play_launch.control.feed import Feed
from play_launch.control.registration import ControlSocket
from play_launch.process import open_files
from play_launch.process.time_slice import ask_for_short_turns, run_ahead
from play_launch.recording.decisions import DecisionLog
from play_launch.recording.log_handler import log_published
from play_launch.recording.resolved_form import (
    event_without,
    in_messages,
    resolved_form,
    taken_secrets,
    without,
)
from play_launch.recording.session import Session, SessionDescription, open_session
from play_launch.recording.topic_recorder import Snapshots
from play_launch.runtime.signals import RunSignals
from play_launch.runtime.startup_priority import run_ahead_of
from play_launch.supervisor.events import GroupSample, OutputLine

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Coroutine, Mapping
    from pathlib import Path

    from play_launch.cli.show.group_totals import GroupTotal
    from play_launch.config.model import ReplayConfig
    from play_launch.control.config_watch import Watched
    from play_launch.deploy.notification import ServiceManager
    from play_launch.recording.limits import RecordingSummary
    from play_launch.recording.recorder import Recorder
    from play_launch.runtime.publisher import Publisher, StopRequests
    from play_launch.runtime.run import Outcome
    from play_launch.runtime.system import System
    from play_launch.supervisor.events import EventSink, LogRecord, RunEvent, SubjectKind
    from play_launch.supervisor.view import SystemView

_log = logging.getLogger(__name__)
_HEAD_START: Final = 1.0
"""Seconds in which the system has the machine for its start."""

_BEFORE_TOPICS: Final = 0.1
"""Seconds before the first look whether the start is over, and topics are to be recorded."""

_BEFORE_CONTROL: Final = 0.2
"""Seconds from the start of the first processes until commands are answered."""


class RunOptions(Struct, frozen=True):
    """How to show a run and where to record it."""

    log_folder: Path | None
    as_json: bool
    quiet: bool
    keeps_duration: bool = False
    """Whether the command line gave the duration, which no other configuration changes then."""
    watched: Watched | None = None
    """What is applied whenever it changes."""
    manager: ServiceManager | None = None
    """Who started us as a service and wants to hear how it goes."""


class RunSink:
    """Records and shows, the output of each process as the configuration says."""

    def __init__(self, recorder: Recorder, display: Display, config: ReplayConfig) -> None:
        self._recorder = recorder
        self._display = display
        self.feed = Feed()
        """Keeps the latest for whoever operates the session."""
        self.used = GroupTotals()
        self._secrets: frozenset[str] = frozenset()
        self.decisions = DecisionLog(recorder.publish)
        self.adopt(config)

    def adopt(self, config: ReplayConfig) -> None:
        """Take another configuration, in the loop's thread."""
        self.hide_secrets(config)
        output = {each.full_name: each.output for each in config.containers}
        output |= {each.full_name: each.output for each in config.nodes}
        self._not_shown = {name for name, where in output.items() if not where.is_shown}
        self._not_recorded = {name for name, where in output.items() if not where.is_recorded}

    def hide_secrets(self, config: ReplayConfig) -> None:
        """Keep what it took from outside out of all events and messages from now on."""
        self._secrets |= taken_secrets(config)
        self.decisions.secrets = self._secrets
        self._recorder.secrets = in_messages(self._secrets)

    def publish(self, event: RunEvent, before: SystemView, after: SystemView) -> None:
        """Take one event, in the loop's thread."""
        self.decisions.note(event)
        if self._secrets:
            event = event_without(event, self._secrets)
        writer = event.process if isinstance(event, OutputLine) else ""
        if writer not in self._not_recorded:
            self._recorder.publish(event)
        if writer not in self._not_shown:
            self._display.publish(event, before, after)
        self.feed.publish(event, before, after)
        if isinstance(event, GroupSample):
            self.used.take(event)

    def publish_log(self, event: LogRecord) -> None:
        """Take a record of the log, in any thread; it changes nothing in the view."""
        if self._secrets:
            event = replace(event, message=without(event.message, self._secrets))
        self._recorder.publish(event)
        self._display.publish_log(event)
        self.feed.publish_log(event)


def run(config: ReplayConfig, options: RunOptions) -> int:
    """Bring the system up, keep it until its end, and return the exit code.

    Raises ``RecordingError`` when the session cannot be recorded from the start; nothing has been
    started then.
    """
    open_files.raise_limit()
    if os.getpriority(os.PRIO_PROCESS, 0) >= 0:
        # What is started later is given back its turns by who starts it, see `SessionGuard`.
        ask_for_short_turns()
        run_ahead()
    with RunSignals() as signals, contextlib.ExitStack() as opened:
        session = open_session(
            _description(config),
            log_folder=options.log_folder or config.log_dir,
            record=config.record,
        )
        # Before it is announced, so that who reads of it can connect.
        control = ControlSocket(str(session.folder.path))
        opened.callback(control.close)
        _announce(config, session, options)
        display = Display(_style(options))
        sink = RunSink(session.recorder, display, config)
        try:
            with log_published(sink.publish_log):
                work = _until_the_end(config, session, sink, signals, options, control=control)
                outcome = asyncio.run(work)
        finally:
            opened.close()
            display.close()
            recording = session.recorder.close()
    _sum_up(outcome, recording, sink.used.get(), options)
    return outcome.exit_code


async def _until_the_end(
    config: ReplayConfig,
    session: Session,
    sink: RunSink,
    signals: RunSignals,
    options: RunOptions,
    *,
    control: ControlSocket,
) -> Outcome:
    from play_launch.runtime.publisher import Publisher, StopRequests  # noqa: PLC0415
    from play_launch.runtime.run import run_system  # noqa: PLC0415

    # What is there now stays to the end; no collection needs to look at it.
    gc.freeze()
    gc.enable()
    stop = StopRequests()
    folder = session.folder.path
    system: asyncio.Future[System] = asyncio.get_running_loop().create_future()
    operable: asyncio.Future[None] = asyncio.get_running_loop().create_future()
    sink.feed.begin()
    snapshots = Snapshots()
    with library_output_logged(), signals.delivered_to(stop.request):
        publisher = Publisher(sink)
        async with (
            # To the very end: the watchdog is to be fed while the others come to theirs.
            _beside("running ahead of others", run_ahead_of(publisher, stop)),
            _beside(
                "reports to systemd", _report(options.manager, publisher, stop, system, operable)
            ),
            _beside("samples of processes", _sample(config, publisher, folder)),
            _beside(
                "care for earlier recordings",
                _look_after_sessions(config, publisher, folder.parent),
            ),
            _beside(
                "the recording of ROS topics",
                _record_topics(config, session, publisher, stop, snapshots=snapshots),
            ),
            _beside(
                "control by commands",
                _serve_control(
                    config,
                    session,
                    system,
                    operable,
                    control=control,
                    publisher=publisher,
                    sink=sink,
                    snapshots=snapshots,
                    options=options,
                ),
            ),
            _beside("the record of the ROS graph", _observe_graph(config, publisher)),
        ):
            return await run_system(
                config, publisher, stop, on_begin=system.set_result, decisions=sink.decisions
            )


@contextlib.asynccontextmanager
async def _beside(what: str, work: Coroutine[None, None, None]) -> AsyncIterator[None]:
    """Run a coroutine while the block runs, which goes on without ``what`` if that fails."""
    task = asyncio.create_task(_failure_logged(what, work))
    try:
        yield
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        work.close()  # it has not begun where the block has ended at once


async def _failure_logged(what: str, work: Coroutine[None, None, None]) -> None:
    try:
        await work
    except Exception:  # noqa: BLE001 - it is logged, and the system goes on
        _log.exception("the system goes on without %s", what)


async def _report(
    manager: ServiceManager | None,
    publisher: Publisher,
    stop: StopRequests,
    system: asyncio.Future[System],
    operable: asyncio.Future[None],
) -> None:
    if manager is None:
        return
    from play_launch.deploy.report import ServiceReport  # noqa: PLC0415 - for services only

    await ServiceReport(manager, publisher, stop, system, operable).run()


async def _sample(config: ReplayConfig, publisher: Publisher, folder: Path) -> None:
    period = config.record.sampling.period
    if not math.isfinite(period):
        return
    await asyncio.sleep(_HEAD_START)
    from play_launch.process.sampling.sampling import sample  # noqa: PLC0415 - after the processes' start

    await sample(lambda: publisher.view, publisher.publish, period=period, folder=folder)


async def _record_topics(
    config: ReplayConfig,
    session: Session,
    publisher: Publisher,
    stop: StopRequests,
    *,
    snapshots: Snapshots,
) -> None:
    if not config.record.ros:
        return
    await asyncio.sleep(_BEFORE_TOPICS)
    from play_launch.cli.record_topics import record_topics  # noqa: PLC0415 - as above

    await record_topics(config, session, publisher, stop, snapshots=snapshots)


async def _serve_control(
    config: ReplayConfig,
    session: Session,
    system: asyncio.Future[System],
    operable: asyncio.Future[None],
    *,
    control: ControlSocket,
    publisher: Publisher,
    sink: RunSink,
    snapshots: Snapshots,
    options: RunOptions,
) -> None:
    operated = await system
    await asyncio.sleep(_BEFORE_CONTROL)
    try:
        from play_launch.control.serve import serve_control  # noqa: PLC0415 - as above

        await serve_control(
            config,
            session,
            operated,
            control=control,
            publisher=publisher,
            feed=sink.feed,
            snapshots=snapshots,
            hide_secrets=sink.hide_secrets,
            adopt=sink.adopt,
            keeps_duration=options.keeps_duration,
            watched=options.watched,
            operable=operable,
        )
    finally:
        if not operable.done():
            operable.set_result(None)  # nobody waits for what does not come
        await asyncio.to_thread(control.close)


async def _look_after_sessions(
    config: ReplayConfig, publisher: Publisher, log_folder: Path
) -> None:
    await asyncio.sleep(_HEAD_START)
    from play_launch.container.ros import spawn_guard  # noqa: PLC0415
    from play_launch.postmortem.upkeep import look_after_sessions  # noqa: PLC0415 - as above

    await look_after_sessions(log_folder, config.record.keep, lambda: publisher.view, spawn_guard())


async def _observe_graph(config: ReplayConfig, sink: EventSink) -> None:
    if not config.graph_daemon:
        return
    await asyncio.sleep(_BEFORE_TOPICS)
    from play_launch.graph_daemon.observer import observe_graph  # noqa: PLC0415 - as above

    await observe_graph({**os.environ, **config.environment}, sink)


def _description(config: ReplayConfig) -> SessionDescription:
    return SessionDescription(
        name=config.name,
        config_name=config.source.name,
        config_text=config.text,
        included_files=[(file.path.name, file.text) for file in config.included_files],
        parameter_files=[(file.path.name, file.text) for file in config.parameter_files],
        resolved_config=_one_line_each(resolved_form(config)),
        argv=sys.argv,
        environ=os.environ,
    )


def _one_line_each(values: Mapping[str, object]) -> str:
    # An indentation would be made by Python's own encoder, ten times as slow as the compiled one.
    lines = (
        f"{json.dumps(key)}: {json.dumps(value, ensure_ascii=False)}"
        for key, value in values.items()
    )
    return "{\n" + ",\n".join(lines) + "\n}"


def _style(options: RunOptions) -> Style:
    stream = sys.stdout
    if options.as_json:
        return JsonStyle(stream, quiet=options.quiet)
    colour = wants_colour(stream)
    if not is_terminal(stream) or os.environ.get("TERM") == "dumb":
        return PlainStyle(stream, quiet=options.quiet, colour=colour)
    from rich.console import Console  # noqa: PLC0415 - not needed where there is no terminal

    console = Console(file=stream, no_color=not colour, highlight=False)
    return LiveStyle(console, quiet=options.quiet, colour=colour)


def _announce(config: ReplayConfig, session: Session, options: RunOptions) -> None:
    if options.as_json:
        values: dict[str, object] = {
            "event": "session",
            "id": session.id,
            "name": config.name,
            "folder": str(session.folder.path),
        }
        _say(encode(values))
    else:
        _say(f"{config.name}: {describe(config)}, recording to {session.folder.path}")


def _say(text: str) -> None:
    with surviving_the_loss_of_stdout():
        sys.stdout.write(f"{text}\n")
        sys.stdout.flush()


def _sum_up(
    outcome: Outcome,
    recording: RecordingSummary,
    used: Mapping[tuple[SubjectKind, str], GroupTotal],
    options: RunOptions,
) -> None:
    from play_launch.cli.show.summary import print_summary, summary_object  # noqa: PLC0415

    if options.as_json:
        values = summary_object(
            outcome.view, outcome.final_view, recording, exit_code=outcome.exit_code, used=used
        )
        _say(encode(values))
        return
    stream = sys.stdout
    with surviving_the_loss_of_stdout():
        print_summary(
            outcome.view,
            outcome.final_view,
            recording,
            stream=stream,
            colour=wants_colour(stream),
            used=used,
        )
        stream.flush()
