"""``play-launch start``, ``stop``, ``restart``, ``load`` and others: one request, its results."""

from __future__ import annotations

import json
import os
import select
from signal import SIGTERM, pidfd_send_signal
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from play_launch import ExitCode
from play_launch.cli import options
from play_launch.cli.connection import connected, report_end
from play_launch.cli.output import printable, say, size
from play_launch.control.protocol import Code, OperationError

if TYPE_CHECKING:
    from collections.abc import Callable

_DONE: Final = {
    "start": "started",
    "stop": "stopped",
    "restart": "restarted",
    "load": "loaded",
    "unload": "unloaded",
    "reload": "reloaded",
    "signal": "signalled",
}
_GRACE: Final = 10.0
"""Seconds that the answer may be later than the timeout."""
_SNAPSHOT_TIMEOUT: Final = 40.0
"""Seconds: gigabytes may have to be written."""

Timeout = Annotated[
    float,
    options.time("How long to wait; the operation itself continues.", "--timeout", default="60s"),
]


def _command(operation: str, about: str) -> Callable[..., None]:
    def run(
        names: options.Units,
        timeout: Timeout = 60.0,
        session: options.Session = None,
        as_json: options.Json = False,
    ) -> None:
        _operate(operation, {"names": names}, timeout, session, as_json=as_json)

    run.__doc__ = about
    return run


start = _command("start", "Start stopped containers or processes, and wait until they run.")
stop = _command("stop", "Stop containers or processes; everything else continues.")
restart = _command("restart", "Stop containers or processes and start them again.")
load = _command("load", "Load composable nodes that are not loaded.")
unload = _command("unload", "Unload composable nodes.")
reload = _command("reload", "Unload composable nodes and load them again.")


def signal(
    signal: Annotated[
        str,
        typer.Argument(
            metavar="SIGNAL",
            help="USR1, SIGINT, 9.",
            show_default=False,
            autocompletion=lambda: ["HUP", "INT", "QUIT", "KILL", "USR1", "USR2", "TERM", "CONT"],
        ),
    ],
    names: options.Units,
    timeout: Timeout = 60.0,
    session: options.Session = None,
    as_json: options.Json = False,
) -> None:
    """Send a signal to containers, processes or isolated nodes."""
    _operate("signal", {"names": names, "signal": signal}, timeout, session, as_json=as_json)


def shutdown(
    timeout: Timeout = 60.0,
    session: options.Session = None,
    as_json: options.Json = False,
) -> int:
    """End a session in order, as SIGTERM does, and wait until its recording is closed."""
    with connected(session) as client:
        folder = client.hello.folder
        try:
            # The session is connected: its number belongs to no other process yet.
            pidfd = os.pidfd_open(client.peer().pid)
            with os.fdopen(pidfd, "rb", buffering=0):
                pidfd_send_signal(pidfd, SIGTERM)
                has_ended = bool(select.select([pidfd], [], [], timeout)[0])
        except OSError as error:
            raise OperationError(
                Code.REFUSED, f"{folder}: its process cannot be reached from here: {error}"
            ) from None
        if not has_ended:
            raise OperationError(Code.TIMEOUT, f"{folder}: it is not over after {timeout:g} s")
        status = report_end(client.hello)
        if as_json and status == ExitCode.OK:
            say(json.dumps({"folder": folder}))
        return status


def snapshot(session: options.Session = None, as_json: options.Json = False) -> None:
    """Write the pre-crash buffer (record.before_crash) into the recording now."""
    with connected(session) as client:
        written = client.ask("snapshot", limit=_SNAPSHOT_TIMEOUT)
    if as_json:
        say(json.dumps(written))
    else:
        say(
            f"{client.hello.folder}: {written['messages']:,} messages, {size(written['bytes'])}, "
            f"of {written['seconds']:.1f} s"
        )


def _operate(
    operation: str,
    arguments: dict[str, Any],
    timeout: float,
    session: str | None,
    *,
    as_json: bool,
) -> None:
    def show(results: Any) -> None:
        if as_json:
            say(json.dumps(results))
            return
        for each in results:
            if each["done"]:
                say(f"{printable(each['name'])}: {_DONE[operation]}")

    with connected(session) as client:
        request = {**arguments, "timeout": timeout}
        try:
            show(client.ask(operation, request, limit=timeout + _GRACE)["results"])
        except OperationError as error:
            show(error.details.get("results", []))
            raise
