"""``play-launch events``: what happens."""

from __future__ import annotations

import json
import sys
from typing import TYPE_CHECKING, Any

from play_launch.cli.operate import OK, add_names, report_end
from play_launch.cli.output import lines_of

if TYPE_CHECKING:
    from argparse import ArgumentParser, Namespace

    from play_launch.control.client import ControlClient


def add_arguments(parser: ArgumentParser, verb: str) -> None:  # noqa: ARG001 - as for all verbs
    """Declare what it takes."""
    add_names(parser, "only events about these", optional=True)
    parser.add_argument(
        "-f", "--follow", action="store_true", help="go on with what happens, until Ctrl-C"
    )
    parser.add_argument("--new", action="store_true", help="leave out what has happened before")
    parser.add_argument(
        "--kind",
        action="append",
        default=[],
        dest="kinds",
        metavar="KIND",
        help="only this kind: node, container, process, component, log, action, graph, managed; "
        "output, process_sample, group_sample and system_sample are left out unless named; may be "
        "repeated",
    )


def run(client: ControlClient, options: Namespace) -> int:
    """Print events, one a line."""
    arguments = {
        "names": options.names,
        "kinds": options.kinds,
        "follow": options.follow,
        "only_new": options.new,
    }
    for message in client.stream("events", arguments):
        if "result" in message:
            return OK
        line = json_line(message) if options.json else text_line(message)
        sys.stdout.write(f"{line}\n")
        sys.stdout.flush()
    return report_end(client.hello)


def text_line(message: dict[str, Any]) -> str:
    """Write a message of the stream for people."""
    if "event" in message:
        return lines_of(message["event"])
    return f"{message.get('missed', 0)} events were too many to send; the recording has them"


def json_line(message: dict[str, Any]) -> str:
    """Write a message of the stream as replay --json writes events."""
    event = message.get("event") or {"event": "missed", "events": message.get("missed", 0)}
    return json.dumps(event, separators=(",", ":"))
