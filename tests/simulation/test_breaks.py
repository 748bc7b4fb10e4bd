"""The simulation can fail: it finds each deliberate break of a rule, by the invariant for it."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

import pytest

from tests.support.breaks import rewrite

from .search import tried

if TYPE_CHECKING:
    from collections.abc import Iterator

MOST_SEEDS: Final = 600
FIRST: Final = (
    *(17, 0, 209, 403, 35, 38, 911, 453, 418, 207, 63),
    *(12, 9, 92, 587, 13, 18, 61, 226, 37, 1135, 30, 94, 5531),
)
"""Seeds each of which found a break that those before it did not; they are tried first."""


class Break(NamedTuple):
    """A line of ``breaks.txt``."""

    found_by: str
    name: str
    where: str
    old: str
    new: str

    def apply(self, patch: pytest.MonkeyPatch) -> None:
        module, _, path = self.where.partition(".")
        names = vars(import_module(f"play_launch.supervisor.{module}"))
        rule = eval(path, names)
        if callable(rule):
            rewrite(patch, rule, self.old, "" if self.new == "nothing" else self.new)
        else:
            patch.setitem(rule, eval(self.old, names), eval(self.new, names))


def breaks() -> Iterator[Break]:
    found_by = ""
    for line in Path(__file__).with_name("breaks.txt").read_text().splitlines():
        if line.startswith("# "):
            found_by = line[2:]
        elif found_by and line:
            yield Break(found_by, *line.split(" ~ "))


@pytest.mark.parametrize("broken", tuple(breaks()), ids=lambda each: each.name)
def test_a_broken_rule_is_found(broken: Break, monkeypatch: pytest.MonkeyPatch) -> None:
    broken.apply(monkeypatch)
    others = set()
    for seed in (*FIRST, *range(MOST_SEEDS)):
        _, found = tried(seed)
        if found is not None and found.name == broken.found_by:
            return
        others |= {found.name} if found is not None else set()
    pytest.fail(f"{broken.found_by!r} breaks with none of {MOST_SEEDS} seeds, only {others}")
