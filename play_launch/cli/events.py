"""``play-launch events`` and ``play-launch logs``: what happens, and what nodes print."""

from __future__ import annotations

import json
import sys
import time
from typing import TYPE_CHECKING, Annotated, Any

import typer

from play_launch.cli import options
from play_launch.cli.connection import connected, report_end
from play_launch.cli.output import clock, clock_times, note, printable
from play_launch.control.protocol import Code, OperationError

if TYPE_CHECKING:
    from collections.abc import Mapping


def events(  # noqa: PLR0917 - options, by name
    names: options.Names = None,
    follow: options.Follow = False,
    new: Annotated[bool, typer.Option("--new", help="Leave out earlier events.")] = False,
    kind: Annotated[
        list[str] | None,
        typer.Option(
            "--kind",
            metavar="KIND",
            help="Only this kind: component, process, log, node, container, graph, withdrawn, "
            "want, action, managed, machine, expectation, recording_interrupted; or, printed only "
            "if named: output, process_sample, group_sample, system_sample. May be repeated.",
            show_default=False,
        ),
    ] = None,
    session: options.Session = None,
    as_json: options.Json = False,
) -> int:
    """Print events, one a line."""
    arguments = {"names": names or [], "kinds": kind or [], "follow": follow, "only_new": new}
    return _print_stream(arguments, session, "events", as_json=as_json)


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
        options.Level | None,
        typer.Option(help="Only lines of this level and above.", show_default=False),
    ] = None,
    session: options.Session = None,
    as_json: options.Json = False,
) -> int:
    """Print output of nodes and the supervisor's log."""
    kinds = ["output"] if names else ["output", "log"]
    arguments = {"names": names or [], "kinds": kinds, "follow": follow}
    return _print_stream(
        arguments,
        session,
        "lines",
        since=since,
        least=options.LEVELS.get(level or "", 0),
        as_json=as_json,
    )


def _print_stream(
    arguments: dict[str, Any],
    session: str | None,
    noun: str,
    *,
    since: str | None = None,
    least: int = 0,
    as_json: bool,
) -> int:
    """Print the events of a session from a time and a level on; return the exit code."""
    with connected(session) as client:
        since_ns = since_when(since, time.time()) if since else 0
        for message in client.stream("events", arguments):
            if "result" in message:
                return 0
            event = message.get("event")
            if event is None:
                missed = message.get("missed", 0)
                if as_json:
                    _print(json.dumps({"event": "missed", "events": missed}))
                else:
                    note(
                        f"skipped {missed} {noun} (the client is too slow); the recording has them"
                    )
            elif event["stamp_ns"] >= since_ns and event["level"] >= least:
                _print(json.dumps(event, separators=(",", ":")) if as_json else text_of(event))
    return report_end(client.hello)


def _print(text: str) -> None:
    sys.stdout.write(f"{text}\n")  # unlike `say`, it ends what follows when the reader has gone
    sys.stdout.flush()


def since_when(text: str, now: float) -> int:
    """Return the time in nanoseconds since the epoch; raises OperationError with the fix."""
    if times := clock_times(text, now):
        return int(1e9 * max(each for each in times if each <= now))
    from play_launch.config.values import parse_duration  # noqa: PLC0415 - slow

    try:
        return int((now - parse_duration(text)) * 1e9)
    except ValueError as error:
        raise OperationError(Code.BAD_ARGUMENTS, f"--since: {error}") from None


def text_of(event: Mapping[str, Any]) -> str:
    """Write an event of the control socket; a text of several lines stays."""
    source = str(event["source"])
    text = str(event["text"]) + (" [cut]" if event.get("truncated") else "")
    clean = printable(text).replace("\n", f"\n{' ' * 13}")
    return f"{clock(event.get('stamp_ns', 0))} [{printable(source)}] {clean}"
