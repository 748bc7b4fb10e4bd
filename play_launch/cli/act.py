"""``play-launch start``, ``stop``, ``restart``, ``load``, ``unload``, ``reload``, ``signal``."""

from __future__ import annotations

import json
import sys
from typing import TYPE_CHECKING, Any, Final

from play_launch.cli.operate import OK, add_names, seconds
from play_launch.cli.output import printable
from play_launch.control.protocol import ControlError

if TYPE_CHECKING:
    from argparse import ArgumentParser, Namespace

    from play_launch.control.client import ControlClient

_WHAT: Final = {
    "start": "containers and processes",
    "stop": "containers and processes",
    "restart": "containers and processes",
    "load": "composable nodes",
    "unload": "composable nodes",
    "reload": "composable nodes",
    "signal": "containers, processes and isolated nodes",
}
_DONE: Final = {
    "start": "started",
    "stop": "stopped",
    "restart": "restarted",
    "load": "loaded",
    "unload": "unloaded",
    "reload": "reloaded",
    "signal": "signalled",
}
_USUAL_LIMIT: Final = 60.0
_SPARE: Final = 10.0
"""Seconds that the answer may be later than what it is about."""


def add_arguments(parser: ArgumentParser, verb: str) -> None:
    """Declare what it takes."""
    if verb == "signal":
        parser.add_argument("signal", metavar="SIGNAL", help="for example USR1, SIGINT or 9")
    add_names(parser, _WHAT[verb])
    parser.add_argument(
        "--timeout",
        type=seconds,
        default=_USUAL_LIMIT,
        metavar="S",
        help=f"seconds until it has to be done ({_USUAL_LIMIT:g}); it goes on after that",
    )


def run(client: ControlClient, options: Namespace) -> int:
    """Have it done, and print what came of it."""
    arguments: dict[str, Any] = {"names": options.names, "timeout": options.timeout}
    if options.verb == "signal":
        arguments["signal"] = options.signal
    try:
        answer = client.ask(options.verb, arguments, limit=options.timeout + _SPARE)
    except ControlError as error:
        _print(options, error.details.get("results", []))
        raise
    _print(options, answer["results"])
    return OK


def _print(options: Namespace, results: Any) -> None:
    if options.json:
        sys.stdout.write(f"{json.dumps(results)}\n")
        return
    for each in results:
        if each["done"]:
            name = printable(each["name"], colour=False)
            sys.stdout.write(f"{name}: {_DONE[options.verb]}\n")
