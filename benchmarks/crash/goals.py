"""The results of all trials against the goals."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from benchmarks.crash.cases import QUIET
from benchmarks.crash.report import (
    DETECTED,
    EVENT_P50,
    EVENT_P99,
    GAP_MAX,
    LOADED_P50,
    Row,
)
from benchmarks.goal import Goal

_POISONED_BY_SEGV, _POISONED_BY_KILL = 1 / 1000, 1 / 20


def goals(rows: Sequence[Row]) -> list[Goal]:
    """One line for each goal that these rows say something about."""
    care = [row for row in rows if row["quiesced"] and row["kind"] != QUIET.name]
    own = [row for row in care if not _is_sudden(row)]
    sudden = [row for row in care if _is_sudden(row)]
    found = [
        _worst(care, "crash to event, median", "event_ms", "p50", EVENT_P50),
        _worst(care, "crash to event, p99", "event_ms", "p99", EVENT_P99),
        _worst(care, "crash to loaded again, median", "loaded_ms", "p50", LOADED_P50),
        _share("faults in a node's own code that cost a container", own, 0.0),
        _gap(own, [row for row in rows if row["kind"] == QUIET.name]),
        _share("SIGSEGV from outside that poisons", _outside(sudden, "segv"), _POISONED_BY_SEGV),
        _share(
            "SIGKILL that poisons",
            # Not the one that does nothing but wait for being killed inside of the DDS.
            [r for r in sudden if r["kind"].startswith("kill/") and r["kind"] != "kill/dds"],
            _POISONED_BY_KILL,
        ),
        _detection(care),
        _count("poisoned containers that needed a person", care, "undetected"),
        _count("neighbours that died as well", care, "collateral"),
        _count("deaths that were not reported", care, "missed"),
    ]
    return [goal for goal in found if goal is not None]


def _is_sudden(row: Row) -> bool:
    how, _, where = row["kind"].partition("/")
    return bool(how == "kill" or where in {"outside", "dds"})


def _outside(rows: Iterable[Row], how: str) -> list[Row]:
    return [row for row in rows if row["kind"] == f"{how}/outside"]


def _name(row: Row) -> str:
    return f"{row['mode']} {row['kind']}"


def _worst(rows: Iterable[Row], what: str, times: str, which: str, goal: float) -> Goal | None:
    values = sorted((row[times][which], _name(row)) for row in rows if row[times] is not None)
    if not values:
        return None
    best, (worst, where) = values[0][0], values[-1]
    met = sum(value < goal for value, _ in values)
    return Goal(
        what,
        f"under {goal:g} ms",
        f"{best:.2f} to {worst:.2f} ms (longest: {where}); {met} of {len(values)} rows reach it",
        worst < goal,
    )


def _share(what: str, rows: Sequence[Row], goal: float) -> Goal | None:
    crashes, restarts = sum(r["crashes"] for r in rows), sum(r["restarts"] for r in rows)
    if not crashes:
        return None
    said = f"fewer than 1 in {1 / goal:,.0f}" if goal else "none"
    return Goal(
        what,
        said,
        f"{restarts} of {crashes:,}",
        restarts / crashes < goal if goal else restarts == 0,
    )


def _gap(rows: Sequence[Row], quiet: Sequence[Row]) -> Goal | None:
    gaps = sorted((row["gap_ms"]["max"], _name(row)) for row in rows if row["gap_ms"])
    if not gaps:
        return None
    worst, where = gaps[-1]
    medians = [row["gap_ms"]["p50"] for row in rows if row["gap_ms"]]
    text = f"{worst:.1f} ms ({where}), median {min(medians):.1f} to {max(medians):.1f} ms"
    undisturbed = [row["gap_ms"] for row in quiet if row["gap_ms"]]
    if undisturbed:
        text += (
            f"; without any crash {max(g['max'] for g in undisturbed):.1f} ms, median "
            f"{max(g['p50'] for g in undisturbed):.1f} ms"
        )
    return Goal(
        "longest gap of a neighbour's 1 kHz timer",
        f"at most {GAP_MAX:g} ms",
        text,
        worst <= GAP_MAX,
    )


def _detection(rows: Sequence[Row]) -> Goal | None:
    times = [row["detection_s"] for row in rows if row["detection_s"]]
    if not times:
        return None
    found = sum(time["count"] for time in times)
    worst = max(time["max"] for time in times)
    text = f"{found:.0f} times, after {min(t['min'] for t in times):.1f} to {worst:.1f} s"
    return Goal("poisoned containers are found", f"within {DETECTED:g} s", text, worst <= DETECTED)


def _count(what: str, rows: Sequence[Row], name: str) -> Goal | None:
    return _none(what, sum(row[name] for row in rows)) if rows else None


def _none(what: str, count: int) -> Goal:
    return Goal(what, "none", f"{count}" if count else "none", count == 0)
