"""Simulates for as long as one likes, on all cores: ``python -m tests.simulation``."""

from __future__ import annotations

import argparse
import itertools
import multiprocessing
import os
import sys
import time
from typing import TYPE_CHECKING, Final

from .search import report, searched, shortened, tried

if TYPE_CHECKING:
    from collections.abc import Iterator

_SHARE: Final = 50
"""Seeds that one process gets at a time."""


def _share(seeds: range) -> tuple[int, list[str]]:
    inputs, reports, first = 0, [], seeds.start
    while first < seeds.stop:
        more, found = searched(range(first, seeds.stop))
        inputs += more
        if found is None:
            break
        reports.append(report(shortened(found)))
        first = found.seed + 1
    return inputs, reports


def _shares(first: int, last: int | None) -> Iterator[range]:
    for begin in itertools.count(first, _SHARE):
        if last is not None and begin >= last:
            return
        yield range(begin, begin + _SHARE if last is None else min(begin + _SHARE, last))


def _one(seed: int, *, has_trace: bool) -> int:
    inputs, found = tried(seed)
    if found is None:
        print(f"seed {seed}: {inputs} inputs, nothing is broken")
        return 0
    print(report(shortened(found)) if has_trace else found.text)
    return 1


def _all(first: int, last: int | None) -> int:
    began, inputs, found = time.monotonic(), 0, 0
    try:
        with multiprocessing.Pool(os.cpu_count()) as pool:
            for more, reports in pool.imap_unordered(_share, _shares(first, last)):
                inputs, found = inputs + more, found + len(reports)
                for each in reports:
                    print(f"{each}\n", flush=True)
    except KeyboardInterrupt:
        pass
    seconds = time.monotonic() - began
    print(f"{inputs} inputs in {seconds:.0f} s, {found} seeds that break an invariant")
    return 1 if found else 0


def main() -> int:
    """Run it."""
    parser = argparse.ArgumentParser(prog="python -m tests.simulation", description=__doc__)
    parser.add_argument("--seeds", metavar="FROM:TO", default="0:", help="without TO: endless")
    parser.add_argument("--seed", type=int, help="only this one")
    parser.add_argument("--trace", action="store_true", help="with --seed: the shortened trace")
    arguments = parser.parse_args()
    if arguments.seed is not None:
        return _one(arguments.seed, has_trace=arguments.trace)
    first, _, last = arguments.seeds.partition(":")
    return _all(int(first or 0), int(last) if last else None)


if __name__ == "__main__":
    sys.exit(main())
