"""The results of trials: as JSON, as a table."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from benchmarks.crash.cases import QUIET, Case
from benchmarks.crash.footprint import Footprint, growth
from benchmarks.crash.tally import Tally
from benchmarks.statistics import Summary

Row = Mapping[str, Any]
"""A trial's result, of JSON's types."""

_TIMES = ("event_ms", "loaded_ms", "gap_ms", "detection_s", "recovery_s")
_COUNTS = (
    "crashes",
    "survived",
    "restarts",
    "recovered",
    "undetected",
    "collateral",
    "missed",
    "doubtful",
    "leaked",
    "given_up",
    "stopped_hard",
)
MODE, KIND = 12, 23

EVENT_P50, EVENT_P99, LOADED_P50, GAP_MAX, DETECTED = 1.0, 5.0, 20.0, 11.0, 5.0
"""The goals: milliseconds, the last one seconds."""


def result(
    case: Case, tally: Tally, taken: Sequence[Footprint], *, seconds: float, complete: bool
) -> Row:
    """What is kept of a trial."""
    times = {name: Summary.of(getattr(tally, name)) for name in _TIMES}
    grown = growth(taken)
    return {
        "mode": case.mode,
        "kind": case.kind.name,
        "quiesced": case.quiesced,
        "wanted": case.count,
        "complete": complete,
        "mechanism": tally.mechanism,
        "seconds": round(seconds, 1),
        **{name: getattr(tally, name) for name in _COUNTS},
        **{name: None if s is None else s.as_json() for name, s in times.items()},
        "reasons": dict(tally.reasons),
        "growth_per_1000": None if grown is None else {n: round(v, 3) for n, v in grown.items()},
    }


def heading() -> str:
    return (
        f"{'':<{MODE + KIND}}{'':>8}{'container':>11}{'poisoned,':>11}{'found':>7}"
        f"{'crash to event':>16}{'to loaded':>16}{'longest gap':>16}{'memory':>8}\n"
        f"{'mode':<{MODE}}{'dies of / where':<{KIND}}{'crashes':>8}{'untouched':>11}"
        f"{'recovered':>11}{'max s':>7}"
        f"{'p50 / p99 ms':>16}{'p50 / p99 ms':>16}{'p50 / max ms':>16}{'MB/1000':>8}"
    )


def label(row: Row) -> str:
    """How and where its nodes die."""
    if row["kind"] == QUIET.name:
        return "nothing"
    return row["kind"] if row["quiesced"] else f"{row['kind']} *"


def line(row: Row) -> str:
    """One row of the table, and below it what went wrong."""
    if row["kind"] == QUIET.name:
        counts = f"{'-':>8}{'-':>11}{'-':>11}{'-':>7}"
    else:
        poisoned = f"{row['restarts']}, {row['recovered']}" if row["restarts"] else "0"
        found = "-" if row["detection_s"] is None else f"{row['detection_s']['max']:.1f}"
        counts = f"{row['crashes']:>8}{row['survived']:>11}{poisoned:>11}{found:>7}"
    text = f"{row['mode']:<{MODE}}{label(row):<{KIND}}{counts}" + "".join(
        f"{_pair(row[name], second):>16}"
        for name, second in (("event_ms", "p99"), ("loaded_ms", "p99"), ("gap_ms", "max"))
    )
    grown = row["growth_per_1000"]
    text += f"{'-' if grown is None else format(grown['memory'], '.1f'):>8}"
    return "\n".join([text, *(f"{'':<{MODE}}! {remark}" for remark in remarks(row))])


def remarks(row: Row) -> list[str]:
    """The summary."""
    said = [
        (row["mechanism"] == "process", "isolated by ordinary processes, without shared memory"),
        (not row["complete"], f"ended early, after {row['seconds']:.0f} s"),
        (row["undetected"], f"{row['undetected']} times the supervisor did not notice"),
        (row["collateral"], f"{row['collateral']} neighbours died"),
        (row["missed"], f"{row['missed']} deaths were not reported"),
        # Without quiescing that is what is tried.
        (
            row["doubtful"] and row["quiesced"],
            f"{row['doubtful']} nodes died with a thread in a doubtful place",
        ),
        (row["leaked"], _leak(row)),
        (row["given_up"], f"{row['given_up']} times something was not restarted again"),
        (row["stopped_hard"], "the container did not end in order"),
    ]
    return [text for happened, text in said if happened]


def table(rows: Iterable[Row]) -> str:
    body = [heading(), *(line(row) for row in rows)]
    return "\n".join([*body, "", "* dies with all threads where they are, without quiescing"])


def _leak(row: Row) -> str:
    if row["kind"].endswith("/constructor"):
        return f"{row['leaked']} half-built nodes left their memory behind"
    return f"{row['leaked']} dead nodes could not be cleaned up after"


def _pair(times: Mapping[str, float] | None, second: str) -> str:
    if times is None:
        return "-"
    return f"{times['p50']:.2f} / {times[second]:.2f}"
