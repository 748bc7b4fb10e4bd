"""``play-launch snapshot``: write the pre-crash buffer of a running session."""

from __future__ import annotations

import json
import sys
from typing import Final

from play_launch.cli import options
from play_launch.cli.connection import connected

_TIMEOUT: Final = 40.0
"""Seconds: gigabytes may have to be written."""


def snapshot(session: options.Session = None, as_json: options.Json = False) -> None:
    """Write the pre-crash buffer (record.before_crash) into the recording now."""
    with connected(session) as client:
        written = client.ask("snapshot", limit=_TIMEOUT)
    if as_json:
        sys.stdout.write(f"{json.dumps(written)}\n")
        return
    from play_launch.cli.output import size  # noqa: PLC0415 - not for --json

    sys.stdout.write(
        f"{client.hello.folder}: {written['messages']:,} messages, {size(written['bytes'])}, "
        f"of {written['seconds']:.1f} s\n"
    )
