"""``play-launch logs``: what nodes print."""

from __future__ import annotations

import json
import sys
import time
from typing import TYPE_CHECKING, Final

from play_launch.cli.operate import OK, add_names, report_end
from play_launch.cli.output import clock_times, lines_of
from play_launch.control.protocol import Code, ControlError

if TYPE_CHECKING:
    from argparse import ArgumentParser, Namespace

    from play_launch.control.client import ControlClient

LEVELS: Final = {"debug": 10, "info": 20, "warn": 30, "error": 40, "fatal": 50}


def add_arguments(parser: ArgumentParser, verb: str) -> None:  # noqa: ARG001 - as for all verbs
    """Declare what it takes."""
    add_names(parser, "only of these", optional=True)
    parser.add_argument("-f", "--follow", action="store_true", help="go on until Ctrl-C")
    parser.add_argument(
        "--since",
        metavar="TIME",
        help="only the last 30s, 5min; or since it was last 14:03",
    )
    parser.add_argument("--level", choices=tuple(LEVELS), help="only lines of this level and above")


def run(client: ControlClient, options: Namespace) -> int:
    """Print lines: those that are kept, and with -f those that come."""
    since_ns = since(options.since, time.time()) if options.since else 0
    kinds = ["output"] if options.names else ["output", "log"]
    arguments = {"names": options.names, "kinds": kinds, "follow": options.follow}
    least = LEVELS[options.level] if options.level else 0
    for message in client.stream("events", arguments):
        if "result" in message:
            return OK
        event = message.get("event")
        if event is None:
            _print_missed(message.get("missed", 0), as_json=options.json)
        elif event["stamp_ns"] >= since_ns and event["level"] >= least:
            text = json.dumps(event, separators=(",", ":")) if options.json else lines_of(event)
            sys.stdout.write(f"{text}\n")
            sys.stdout.flush()
    return report_end(client.hello)


def since(text: str, now: float) -> int:
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
        sys.stderr.write(f"{missed} lines were too many to send; the recording has them\n")
