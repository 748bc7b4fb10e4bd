"""Write the recording of a long session that never ran.

python -m benchmarks.long_session FILE [--nodes N] [--hours H] [--period S] [--crashes N]
    [--lines N]
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from benchmarks.long_session.plan import Plan
from benchmarks.long_session.write import write_session


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("file", type=Path)
    parser.add_argument("--nodes", type=int, default=Plan.nodes)
    parser.add_argument("--hours", type=float, default=Plan.seconds / 3600)
    parser.add_argument("--period", type=float, default=Plan.period, help="seconds")
    parser.add_argument("--crashes", type=int, default=Plan.crashes)
    parser.add_argument("--lines", type=int, default=Plan.lines)
    parser.add_argument("--seed", type=int, default=Plan.seed)
    arguments = parser.parse_args()
    plan = Plan(
        nodes=arguments.nodes,
        seconds=arguments.hours * 3600,
        crashes=arguments.crashes,
        lines=arguments.lines,
        period=arguments.period,
        seed=arguments.seed,
    )
    begin = time.monotonic()
    count = write_session(arguments.file, plan)
    size = arguments.file.stat().st_size / 1e6
    print(f"{arguments.file}: {count:,} messages, {size:.1f} MB, {time.monotonic() - begin:.1f} s")


if __name__ == "__main__":
    main()
