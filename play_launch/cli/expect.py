"""``play-launch expect``: what topics are expected to be, and what they are."""

from __future__ import annotations

import json
from typing import Any, Final

from play_launch import ExitCode
from play_launch.cli import options
from play_launch.cli.connection import connected
from play_launch.cli.output import duration, printable, say, table

_TITLES: Final = ("TOPIC", "STATE", "RATE", "LONGEST GAP", "PUBLISHERS", "BROKEN", "DETAILS")
_STATES: Final = {None: "not known yet", True: "as expected", False: "broken"}


def expect(session: options.Session = None, as_json: options.Json = False) -> int:
    """Compare topics with what is expected of them (expect: in the configuration).

    Exits with 1 when one of them is not as expected.
    """
    with connected(session) as client:
        rows = client.ask("expectations")
    if as_json:
        say(json.dumps(rows))
    elif not rows:
        say("nothing is expected of topics; give expect: in the configuration")
    else:
        machines = any("machine" in row for row in rows)
        laid = [(*((row["machine"],) if machines else ()), *cells(row)) for row in rows]
        titles = (("MACHINE", *_TITLES)) if machines else _TITLES
        say("\n".join(table(titles, laid, words=3 if machines else 2)))
    return ExitCode.OK if all(row["is_met"] for row in rows) else ExitCode.NODE_FAILED


def cells(row: dict[str, Any]) -> tuple[str, ...]:
    """Give a row for people: topic, state, rate, gap, publishers, breaks, what differs."""
    rate, gap = row["rate"], row["max_gap"]
    return (
        printable(row["topic"]),
        _STATES[row["is_met"]],
        "-" if rate is None else f"{rate:.3g} Hz",
        "-" if gap is None else duration(round(gap * 1e9)),
        str(row["publishers"]),
        str(row["breaks"]),
        printable(row["reason"]),
    )
