"""``play-launch logs``: what nodes print."""

from __future__ import annotations

import json
import sys
import time
from typing import Annotated, Final, Literal

import typer

from play_launch.cli import options
from play_launch.cli.connection import connected, report_end
from play_launch.cli.output import clock_times, lines_of
from play_launch.control.protocol import Code, ControlError

LEVELS: Final = {"debug": 10, "info": 20, "warn": 30, "error": 40, "fatal": 50}


def logs(  # noqa: PLR0917 - options, by name
    names: options.Names = None,
    follow: options.Follow = False,
    since: Annotated[
        str | None,
        typer.Option(
            metavar="TIME",
            help="Only the last 30s, 5min; or from a time of the day on, 14:03.",
            show_default=False,
        ),
    ] = None,
    level: Annotated[
        Literal["debug", "info", "warn", "error", "fatal"] | None,
        typer.Option(help="Only lines of this level and above.", show_default=False),
    ] = None,
    session: options.Session = None,
    as_json: options.Json = False,
) -> int:
    """Print output of nodes and the supervisor's log."""
    with connected(session) as client:
        since_ns = since_when(since, time.time()) if since else 0
        kinds = ["output"] if names else ["output", "log"]
        least = LEVELS[level] if level else 0
        arguments = {"names": names or [], "kinds": kinds, "follow": follow}
        for message in client.stream("events", arguments):
            if "result" in message:
                return 0
            event = message.get("event")
            if event is None:
                _print_missed(message.get("missed", 0), as_json=as_json)
            elif event["stamp_ns"] >= since_ns and event["level"] >= least:
                text = json.dumps(event, separators=(",", ":")) if as_json else lines_of(event)
                sys.stdout.write(f"{text}\n")
                sys.stdout.flush()
    return report_end(client.hello)


def since_when(text: str, now: float) -> int:
    """Give the time that is meant, in nanoseconds since the epoch; ControlError with the fix."""
    if times := clock_times(text, now):
        return int(1e9 * max(each for each in times if each <= now))
    from play_launch.config.values import parse_duration  # noqa: PLC0415 - slow

    try:
        return int((now - parse_duration(text)) * 1e9)
    except ValueError as error:
        raise ControlError(Code.BAD_ARGUMENTS, f"--since: {error}") from None


def _print_missed(missed: int, *, as_json: bool) -> None:
    if as_json:
        sys.stdout.write(f"{json.dumps({'event': 'missed', 'events': missed})}\n")
    else:
        text = f"skipped {missed} lines (this client is too slow); they are in the recording"
        sys.stderr.write(f"{text}\n")
