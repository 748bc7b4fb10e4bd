"""Verb ``compare``: what is worse or better in the second of two sessions."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import msgspec

from play_launch import ExitCode
from play_launch.cli import options
from play_launch.cli.info import report_damage
from play_launch.cli.output import printable, say
from play_launch.postmortem import comparison
from play_launch.postmortem.comparison import (
    Comparison,
    CrashChange,
    Deviation,
    Measure,
    ParameterChange,
)
from play_launch.postmortem.parameters import shortened
from play_launch.postmortem.timeline import read_timeline

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

_MOST_LINES: Final = 50
"""Of one section."""
_SAYS: Final = {
    Measure.BRING_UP: "is loaded {1:.1f} s after the start instead of {0:.1f} s",
    Measure.RESTARTS: "is restarted {1:.0f} times instead of {0:.0f}",
    Measure.PEAK_MEMORY: "uses {1:.0f} MB at most instead of {0:.0f} MB",
    Measure.CPU: "uses {1:.0f} % of a core instead of {0:.0f} %",
}


def compare(
    first: Annotated[Path, options.argument("A", "The earlier session.")],
    second: Annotated[Path, options.argument("B", "The later session.")],
    as_json: options.Json = False,
) -> int:
    """Compare two sessions: bring-up, restarts, crashes, memory and CPU of each node.

    Exits with 1 if the second one is worse: a new crash, a node that is not loaded, one more
    restart, or an increase by half of time (and a second), memory (and 64 MB) or CPU (and 10 % of a
    core). Exits with 2 if a file is not a recording, with 5 if one could not be read completely.
    """
    sessions = read_timeline(first), read_timeline(second)
    found = comparison.compare(*sessions)
    if as_json:
        values = {
            "first": _text(first),
            "second": _text(second),
            "worse": found.is_worse,
            **msgspec.to_builtins(found),
        }
        values["changes"] = [
            {**msgspec.to_builtins(each), "worse": each.is_worse, "better": each.is_better}
            for each in found.changes
        ]
        say(msgspec.json.encode(values).decode())
    else:
        for title, lines in _sections(found).items():
            for line in _section(title, lines):
                say(printable(line))
        say(f"The second session is {'worse' if found.is_worse else 'not worse'}.")
    damaged = [report_damage(each.session.reader) for each in sessions]
    if any(damaged):
        return ExitCode.DAMAGED
    return ExitCode.NODE_FAILED if found.is_worse else ExitCode.OK


def _text(path: Path) -> str:
    """Write a name that is not UTF-8 with escapes."""
    return str(path).encode("utf-8", "backslashreplace").decode()


def _section(title: str, lines: Sequence[str]) -> Iterator[str]:
    if lines:
        yield f"{title}:"
        yield from (f"  {line}" for line in lines[:_MOST_LINES])
        if len(lines) > _MOST_LINES:
            yield f"  and {len(lines) - _MOST_LINES} more; --json gives all"


def _sections(found: Comparison) -> dict[str, Sequence[str]]:
    worse = [_change(each) for each in found.changes if each.is_worse]
    better = [_change(each) for each in found.changes if each.is_better]
    crashes = [f"new crash: {_crash(each, f'{each.after} times')}" for each in found.new_crashes]
    failures = [f"{key} is not loaded any more" for key in found.new_failures]
    more = [f"more crashes: {_crash(each, _counts(each))}" for each in found.more_crashes]
    fewer = [f"fewer crashes: {_crash(each, _counts(each))}" for each in found.fewer_crashes]
    gone = [f"gone crash: {_crash(each, f'{each.before} times')}" for each in found.gone_crashes]
    return {
        "Worse": [*crashes, *more, *failures, *worse],
        "Better": [*gone, *fewer, *better],
        "Only in the first": found.gone_members,
        "Only in the second": found.new_members,
        "Parameters that differ": [_parameter(each) for each in found.parameters],
    }


def _change(change: Deviation) -> str:
    scale = 1e-6 if change.measure is Measure.PEAK_MEMORY else 1.0
    words = _SAYS[change.measure].format(change.before * scale, change.after * scale)
    return f"{change.name} {words}"


def _crash(change: CrashChange, how_often: str) -> str:
    return f"{change.signature.id} {change.signature}, {how_often}, {', '.join(change.units)}"


def _counts(change: CrashChange) -> str:
    return f"{change.after} times instead of {change.before}"


def _parameter(change: ParameterChange) -> str:
    before, after = (
        "not set" if value is None else shortened(value) for value in (change.before, change.after)
    )
    return f"{change.node} {change.name}: {before} -> {after}"
