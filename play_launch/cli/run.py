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

from play_launch.cli.find_mistakes import describe
from play_launch.cli.show.display import Display, Style
from play_launch.cli.show.json_style import JsonStyle, encode
from play_launch.cli.show.terminal import is_terminal, surviving_the_loss_of_stdout, wants_colour
from play_launch.cli.show.text_styles import LiveStyle, PlainStyle
from play_launch.cli.signals import RunSignals
from play_launch.config.description import describe as describe_values
from play_launch.recording.log_handler import log_published
from play_launch.recording.session import Session, SessionDescription, open_session

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from play_launch.actors.system import Outcome
    from play_launch.config import ReplayConfig
    from play_launch.core.events import EventSink, LogRecord, RunEvent
    from play_launch.core.view import SystemView
    from play_launch.recording.recorder import Recorder, RecordingSummary

_log = logging.getLogger(__name__)


class RunOptions(Struct, frozen=True):
    """How to show a run and where to record it."""

    log_folder: Path | None
    as_json: bool
    quiet: bool


class RunSink:
    """Records and shows."""

    def __init__(self, recorder: Recorder, display: Display) -> None:
        self._recorder = recorder
        self._display = display

    def publish(self, event: RunEvent, before: SystemView, after: SystemView) -> None:
        """Take one event, in the loop's thread."""
        self._recorder.publish(event)
        self._display.publish(event, before, after)

    def publish_log(self, event: LogRecord) -> None:
        """Take a record of the log, in any thread; it changes nothing in the view."""
        self._recorder.publish(event)
        self._display.publish_log(event)


def run(config: ReplayConfig, options: RunOptions) -> int:
    """Bring the system up, keep it until its end, and return the exit code.

    Raises ``RecordingError`` when the session cannot be recorded from the start; nothing has been
    started then.
    """
    with RunSignals() as signals:
        session = open_session(
            _description(config),
            on_failure=lambda message: _log.error("the recording stopped: %s", message),
            log_folder=options.log_folder or config.log_dir,
        )
        _announce(config, session, options)
        display = Display(_style(options))
        sink = RunSink(session.recorder, display)
        try:
            with log_published(sink.publish_log):
                outcome = asyncio.run(_until_the_end(config, sink, signals))
        finally:
            display.close()
            recording = session.recorder.close()
    _report(outcome, recording, options)
    return outcome.exit_code


async def _until_the_end(config: ReplayConfig, sink: RunSink, signals: RunSignals) -> Outcome:
    from play_launch.actors.publisher import Publisher  # noqa: PLC0415
    from play_launch.actors.stop_requests import StopRequests  # noqa: PLC0415
    from play_launch.actors.system import run_system  # noqa: PLC0415

    # What is there now stays to the end; no collection needs to look at it.
    gc.freeze()
    gc.enable()
    stop = StopRequests()
    with signals.delivered_to(stop.request):
        publisher = Publisher(sink)
        async with _graph_daemon(config, publisher):
            return await run_system(config, publisher, stop)


def _graph_daemon(
    config: ReplayConfig, sink: EventSink
) -> contextlib.AbstractAsyncContextManager[None]:
    if not config.graph_daemon:
        return contextlib.nullcontext()
    from play_launch.graph_daemon.control.observer import observed_graph  # noqa: PLC0415

    return observed_graph({**os.environ, **config.environment}, sink)


def _description(config: ReplayConfig) -> SessionDescription:
    return SessionDescription(
        name=config.name,
        config_name=config.source.name,
        config_text=config.text,
        parameter_files=[(file.path.name, file.text) for file in config.parameter_files],
        resolved_config=_one_line_each(describe_values(config)),
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


def _report(outcome: Outcome, recording: RecordingSummary, options: RunOptions) -> None:
    from play_launch.cli.show.summary import print_summary, summary_object  # noqa: PLC0415

    if options.as_json:
        values = summary_object(outcome.view, recording, exit_code=outcome.exit_code)
        _say(encode(values))
        return
    stream = sys.stdout
    with surviving_the_loss_of_stdout():
        print_summary(outcome.view, recording, stream=stream, colour=wants_colour(stream))
        stream.flush()
