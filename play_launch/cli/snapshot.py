"""``play-launch snapshot``: have a running session write what it holds in memory."""

from __future__ import annotations

import json
import sys
from typing import TYPE_CHECKING, Final

from play_launch.cli.operate import OK

if TYPE_CHECKING:
    from argparse import ArgumentParser, Namespace

    from play_launch.control.client import ControlClient

_LONGEST: Final = 40.0
"""Seconds: gigabytes may have to be written."""


def add_arguments(parser: ArgumentParser, verb: str) -> None:
    """It takes nothing of its own."""


def run(client: ControlClient, options: Namespace) -> int:
    """Have the last seconds of the topics of record.before_crash written into the recording."""
    written = client.ask("snapshot", limit=_LONGEST)
    if options.json:
        sys.stdout.write(f"{json.dumps(written)}\n")
        return OK
    from play_launch.cli.output import size  # noqa: PLC0415 - not for --json

    sys.stdout.write(
        f"{client.hello.folder}: {written['messages']:,} messages, {size(written['bytes'])}, "
        f"of {written['seconds']:.1f} s\n"
    )
    return OK
