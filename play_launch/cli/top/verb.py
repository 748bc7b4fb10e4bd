"""``play-launch top``: what runs, on a screen that is kept up to date."""

from __future__ import annotations

import os
import sys
from typing import TYPE_CHECKING, Final

from play_launch.cli.operate import report_end
from play_launch.control.protocol import Code, ControlError

if TYPE_CHECKING:
    from argparse import ArgumentParser, Namespace

    from play_launch.cli.top.app import End
    from play_launch.control.client import ControlClient, Hello

_OF_SIGNALS: Final = 128
_PICTURE_SIZE: Final = (100, 28)


def add_arguments(parser: ArgumentParser, verb: str) -> None:  # noqa: ARG001 - as for all verbs
    """Declare what it takes."""
    parser.epilog = "? lists the keys. Leaving it changes nothing in the session."
    parser.add_argument(
        "--svg", metavar="FILE", help="write a picture of the screen and end; needs no terminal"
    )


def run(client: ControlClient, options: Namespace) -> int:
    """Show the screen until somebody leaves it or the session ends; raises ControlError."""
    if options.json:
        raise ControlError(
            Code.BAD_ARGUMENTS,
            "top is for people; for programs there are play-launch ps --json and play-launch "
            "events -f --json",
        )
    if options.svg:
        from play_launch.cli.top.picture import write_picture  # noqa: PLC0415 - slow, as below

        return write_picture(client, options.svg, _PICTURE_SIZE)
    from play_launch.cli.top.terminal import objection  # noqa: PLC0415

    if why_not := objection(sys.stdin, sys.stdout, os.environ):
        raise ControlError(Code.BAD_ARGUMENTS, why_not)
    from play_launch.cli.top.show import show  # noqa: PLC0415

    return _left(client.hello, show(client))


def _left(hello: Hello, end: End) -> int:
    """Say why the screen was left, where a person did not do it; return the exit code."""
    if end.signal:
        return _OF_SIGNALS + end.signal
    return report_end(hello, end.reason) if end.is_lost else 0
