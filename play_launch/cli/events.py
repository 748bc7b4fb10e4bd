"""``play-launch events``: what happens."""

from __future__ import annotations

import json
import sys
from typing import Annotated, Any

import typer

from play_launch.cli import options
from play_launch.cli.connection import connected, report_end
from play_launch.cli.output import lines_of


def events(  # noqa: PLR0917 - options, by name
    names: options.Names = None,
    follow: options.Follow = False,
    new: Annotated[bool, typer.Option("--new", help="Leave out earlier events.")] = False,
    kind: Annotated[
        list[str] | None,
        typer.Option(
            "--kind",
            metavar="KIND",
            help="Only this kind: node, container, process, component, log, action, graph, "
            "managed, output, process_sample, group_sample, system_sample; the last four are "
            "printed only if named. May be repeated.",
            show_default=False,
        ),
    ] = None,
    session: options.Session = None,
    as_json: options.Json = False,
) -> int:
    """Print events, one a line."""
    arguments = {"names": names or [], "kinds": kind or [], "follow": follow, "only_new": new}
    with connected(session) as client:
        for message in client.stream("events", arguments):
            if "result" in message:
                return 0
            line = json_line(message) if as_json else text_line(message)
            sys.stdout.write(f"{line}\n")
            sys.stdout.flush()
    return report_end(client.hello)


def text_line(message: dict[str, Any]) -> str:
    """Write a message of the stream for people."""
    if "event" in message:
        return lines_of(message["event"])
    skipped = message.get("missed", 0)
    return f"skipped {skipped} events (this client is too slow); they are in the recording"


def json_line(message: dict[str, Any]) -> str:
    """Write a message of the stream as replay --json writes events."""
    event = message.get("event") or {"event": "missed", "events": message.get("missed", 0)}
    return json.dumps(event, separators=(",", ":"))
