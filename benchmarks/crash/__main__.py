"""Crash nodes by the thousand and observe the others.

    python -m benchmarks.crash [--count N] [--modes isolated,isolated_mt] [--kinds 'segv/*,…']
                               [--unquiesced …] [--json FILE] [--quick]

A container with a node that dies again and again, and two neighbours with 1 kHz timers that hear
it by pointer; the supervisor is the real one, without pauses before reloads. Kinds are way/place:
segv, abrt, exception, kill (SIGKILL to itself) in a callback, the constructor, a thread of its own,
or a callback while other threads allocate (malloc). segv/publishing is in a callback while another
thread publishes over DDS without a pause. For segv and kill, `outside` is from another process at a
random instant, and `dds` the same while a thread publishes like that.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.crash.cases import MODES, Case, choose, plan
from benchmarks.crash.goals import goals
from benchmarks.crash.report import Row, heading, line, result
from benchmarks.crash.trial import run_trial
from benchmarks.machine import machine
from benchmarks.progress import Progress
from benchmarks.systems import keep_to_this_machine

_QUICK_COUNT = 20
_QUICK_LIMIT = 40.0


def main(words: Sequence[str] | None = None) -> None:
    arguments = _arguments(words)
    logging.getLogger("play_launch").addHandler(
        logging.StreamHandler() if arguments.verbose else logging.NullHandler()
    )
    keep_to_this_machine()
    try:
        kinds = choose(arguments.kinds)
        if arguments.unquiesced is None:
            unquiesced = [kind for kind in kinds if kind.how == "segv"]
        else:
            unquiesced = choose(arguments.unquiesced)
        cases = list(plan(arguments.modes, kinds, unquiesced, count=arguments.count))
    except ValueError as error:
        raise SystemExit(f"benchmarks.crash: {error}") from None
    print(heading(), flush=True)
    rows: list[Row] = []
    try:
        _try_all(cases, arguments, rows)
    except KeyboardInterrupt:
        raise SystemExit(130) from None
    print("\n* dies with all threads where they are, without quiescing")


def _try_all(cases: Sequence[Case], arguments: argparse.Namespace, rows: list[Row]) -> None:
    for number, case in enumerate(cases, 1):
        row = _try(case, arguments.limit, f"{number}/{len(cases)} {case.name}")
        print(line(row), flush=True)
        rows.append(row)
        _keep(arguments, rows)  # each time: what is measured is not lost when it is interrupted
    print("\n".join(goal.line for goal in goals(rows)))


def _try(case: Case, limit: float, label: str) -> Row:
    progress = Progress()
    tally, taken, complete = asyncio.run(
        run_trial(case, limit=limit, report=lambda text: progress.tell(f"{label}: {text}"))
    )
    enough = tally.crashes >= case.count or not case.kind.is_crash
    return result(case, tally, taken, seconds=progress.seconds, complete=complete and enough)


def _keep(arguments: argparse.Namespace, rows: Sequence[Row]) -> None:
    if arguments.json is not None:
        document: dict[str, Any] = {"benchmark": "crash", "machine": machine(), "rows": rows}
        arguments.json.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


def _list(text: str) -> list[str]:
    return [part.strip() for part in text.split(",") if part.strip()]


def _modes(text: str) -> list[str]:
    modes = _list(text)
    if not modes or not set(modes) <= set(MODES):
        raise argparse.ArgumentTypeError(f"one or more of {', '.join(MODES)}")
    return modes


def _arguments(words: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="benchmarks.crash",
        description=__doc__,
        formatter_class=argparse.RawTextHelpFormatter,
    )
    parser.add_argument("--count", type=int, default=None, help="crashes per trial (1000)")
    parser.add_argument("--modes", type=_modes, default=list(MODES))
    parser.add_argument("--kinds", type=_list, default=["*"], help="patterns")
    parser.add_argument(
        "--unquiesced",
        type=_list,
        default=None,
        help="kinds to try without quiescing as well, a fifth as often; '' for none\n"
        "(those with segv among --kinds)",
    )
    parser.add_argument("--limit", type=float, default=None, help="seconds per trial (600)")
    parser.add_argument("--json", type=Path, default=None)
    parser.add_argument("--quick", action="store_true", help=f"{_QUICK_COUNT} crashes per trial")
    parser.add_argument("--verbose", action="store_true", help="the supervisor's log on stderr")
    arguments = parser.parse_args(words)
    arguments.count = arguments.count or (_QUICK_COUNT if arguments.quick else 1000)
    arguments.limit = arguments.limit or (_QUICK_LIMIT if arguments.quick else 600.0)
    if arguments.count < 1 or arguments.limit <= 0:
        parser.error("--count and --limit must be above 0")
    if arguments.json is not None and not arguments.json.parent.is_dir():
        parser.error(f"there is no folder {arguments.json.parent}")
    return arguments


if __name__ == "__main__":
    main()
