"""``play-launch start``, ``stop``, ``restart``, ``load``, ``unload``, ``reload``, ``signal``."""

from __future__ import annotations

import json
import sys
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from play_launch.cli import options
from play_launch.cli.connection import connected
from play_launch.cli.output import printable
from play_launch.control.protocol import ControlError

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
_SPARE: Final = 10.0
"""Seconds that the answer may be later than the timeout."""

Timeout = Annotated[
    float, options.timeout("How long to wait; the operation itself continues.", "60s")
]


def _command(operation: str, about: str) -> Callable[..., None]:
    def run(
        names: options.Units,
        timeout: Timeout = 60.0,
        session: options.Session = None,
        as_json: options.Json = False,
    ) -> None:
        _operate(operation, names, timeout, session, as_json=as_json)

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
    _operate("signal", names, timeout, session, as_json=as_json, more={"signal": signal})


def _operate(
    operation: str,
    names: list[str],
    timeout: float,
    session: str | None,
    *,
    as_json: bool,
    more: dict[str, Any] | None = None,
) -> None:
    arguments = {"names": names, "timeout": timeout, **(more or {})}
    with connected(session) as client:
        try:
            results = client.ask(operation, arguments, limit=timeout + _SPARE)["results"]
        except ControlError as error:
            _print(operation, error.details.get("results", []), as_json=as_json)
            raise
        _print(operation, results, as_json=as_json)


def _print(operation: str, results: Any, *, as_json: bool) -> None:
    if as_json:
        sys.stdout.write(f"{json.dumps(results)}\n")
        return
    for each in results:
        if each["done"]:
            name = printable(each["name"], colour=False)
            sys.stdout.write(f"{name}: {_DONE[operation]}\n")
