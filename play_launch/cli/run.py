"""Runs a system: recording, display and signals around ``run_system``."""

from __future__ import annotations

import asyncio
import contextlib
import gc
import json
import logging
import os
import sys
from typing import TYPE_CHECKING

from msgspec import Struct
from msgspec.structs import replace

from play_launch.cli.background import Background, library_output_logged
from play_launch.cli.check import describe
from play_launch.cli.output import is_terminal, say_live, wants_colour
from play_launch.cli.show.display import (
    Display,
    JsonStyle,
    LiveStyle,
    PlainStyle,
    ShownEvent,
    Style,
    encode,
)
from play_launch.cli.show.summary import Summary
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
from play_launch.runtime.signals import RunSignals, StopRequests
from play_launch.supervisor.events import GroupSample, OutputLine
from play_launch.supervisor.expectations import Expectations

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from play_launch.config.model import ReplayConfig
    from play_launch.control.config_watch import Watched
    from play_launch.deploy.notification import ServiceManager
    from play_launch.recording.limits import RecordingSummary
    from play_launch.recording.recorder import Recorder
    from play_launch.runtime.run import RunOutcome
    from play_launch.supervisor.events import LogRecord, RunEvent, SubjectKind
    from play_launch.supervisor.view import SystemView

_log = logging.getLogger(__name__)


class GroupTotal(Struct, frozen=True, kw_only=True):
    """The sums over all control groups of one unit; see `GroupSample`."""

    cpu_seconds: float = 0.0
    throttled_periods: int = 0
    throttled_seconds: float = 0.0
    oom_kills: int = 0
    pids_max_hits: int = 0

    @property
    def is_throttled(self) -> bool:
        return bool(self.throttled_periods or self.oom_kills or self.pids_max_hits)


class GroupTotals:
    """Sums of a run's samples; of each control group, the last sample counts."""

    def __init__(self) -> None:
        self._last: dict[tuple[SubjectKind, str], dict[int, GroupSample]] = {}

    def add(self, sample: GroupSample) -> None:
        """Add a sample; one that is older than the last one of its group changes nothing."""
        groups = self._last.setdefault((sample.kind, sample.key), {})
        if sample.stamp_ns >= groups.get(sample.group, sample).stamp_ns:
            groups[sample.group] = sample

    def get(self) -> dict[tuple[SubjectKind, str], GroupTotal]:
        """Return the sums by kind and key, in the order in which they were seen first."""
        fields = GroupTotal.__struct_fields__
        return {
            unit: GroupTotal(
                **{name: sum(getattr(each, name) for each in groups.values()) for name in fields}
            )
            for unit, groups in self._last.items()
        }


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
    """Service manager to notify, if any."""


class RunSink:
    """Records and shows, the output of each process as the configuration says."""

    def __init__(self, recorder: Recorder, display: Display, config: ReplayConfig) -> None:
        self._recorder = recorder
        self._display = display
        self.feed = Feed()
        """Recent events, for clients of the session."""
        self.used = GroupTotals()
        self._secrets: frozenset[str] = frozenset()
        self.decisions = DecisionLog(recorder.publish)
        self.adopt(config)

    def adopt(self, config: ReplayConfig) -> None:
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
            self.used.add(event)

    def publish_log(self, event: LogRecord) -> None:
        """Take a record of the log, in any thread; it changes nothing in the view."""
        if self._secrets:
            event = replace(event, message=without(event.message, self._secrets))
        self._recorder.publish(event)
        self._display.publish_alone(event)
        self.feed.publish_log(event)

    def show_output(self, line: OutputLine) -> None:
        """Show a line to the user alone: it is neither recorded nor sent to clients."""
        self._display.publish_alone(line)


def run(config: ReplayConfig, options: RunOptions) -> int:
    """Bring the system up, keep it until its end, and return the exit code.

    Raises ``RecordingError`` when the session cannot be recorded from the start; nothing has been
    started then.
    """
    open_files.raise_limit()
    if os.getpriority(os.PRIO_PROCESS, 0) >= 0:
        # `SessionGuard` restores the time slice of the processes that it starts.
        ask_for_short_turns()
        run_ahead()
    with RunSignals() as signals, contextlib.ExitStack() as opened:
        session = open_session(
            description_of(config),
            log_folder=options.log_folder or config.log_dir,
            record=config.record,
        )
        # Before the announcement: its readers can connect at once.
        control = ControlSocket(str(session.folder))
        opened.callback(control.close)
        _announce(config, session, options)
        display = Display(_style(options), quiet=options.quiet)
        sink = RunSink(session.recorder, display, config)
        try:
            with log_published(sink.publish_log):
                work = _until_the_end(config, session, sink, signals, options, control=control)
                outcome = asyncio.run(work)
        finally:
            opened.close()
            display.close()
            recording = session.recorder.close()
            display.leave()
    _sum_up(outcome, recording, sink.used, options)
    return outcome.exit_code


async def _until_the_end(
    config: ReplayConfig,
    session: Session,
    sink: RunSink,
    signals: RunSignals,
    options: RunOptions,
    *,
    control: ControlSocket,
) -> RunOutcome:
    from play_launch.runtime.publisher import Publisher  # noqa: PLC0415
    from play_launch.runtime.run import run_system  # noqa: PLC0415

    # What is there now stays to the end; no collection needs to look at it.
    gc.freeze()
    gc.enable()
    stop = StopRequests()
    sink.feed.begin()
    with library_output_logged(), signals.delivered_to(stop.request):
        publisher = Publisher(sink)
        background = Background(
            config=config,
            session=session,
            sink=sink,
            options=options,
            control=control,
            publisher=publisher,
            stop=stop,
            snapshots=Snapshots(),
            expectations=Expectations(config.expect),
            system=asyncio.get_running_loop().create_future(),
            operable=asyncio.get_running_loop().create_future(),
        )
        async with background.running():
            return await run_system(
                config,
                publisher,
                stop,
                on_begin=background.system.set_result,
                decisions=sink.decisions,
            )


def description_of(config: ReplayConfig) -> SessionDescription:
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


def _style(options: RunOptions) -> Style[ShownEvent]:
    stream = sys.stdout
    if options.as_json:
        return JsonStyle(stream)
    colour = wants_colour(stream)
    if not is_terminal(stream) or os.environ.get("TERM") == "dumb":
        return PlainStyle(stream, colour=colour)
    from rich.console import Console  # noqa: PLC0415 - not needed where there is no terminal

    console = Console(file=stream, no_color=not colour, highlight=False)
    return LiveStyle(console, colour=colour)


def _announce(config: ReplayConfig, session: Session, options: RunOptions) -> None:
    if options.as_json:
        values: dict[str, object] = {
            "event": "session",
            "id": session.id,
            "name": config.name,
            "folder": str(session.folder),
        }
        say_live(encode(values))
    else:
        say_live(f"{config.name}: {describe(config)}, recording to {session.folder}")


def _sum_up(
    outcome: RunOutcome, recording: RecordingSummary, used: GroupTotals, options: RunOptions
) -> None:
    summary = Summary(outcome.view, outcome.final_view, recording, used.get())
    if options.as_json:
        say_live(encode(summary.as_object(outcome.exit_code)))
    else:
        say_live(summary.text(colour=wants_colour(sys.stdout)))
