"""The simulation can fail: it finds each deliberate break of a rule, by the invariant for it."""

from __future__ import annotations

import inspect
import textwrap
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import pytest

from .search import tried

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

MOST_SEEDS: Final = 600


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


def rewrite(patch: pytest.MonkeyPatch, rule: Callable[..., Any], old: str, new: str) -> None:
    """Replace ``old``, which has to be there once, for all callers of the rule."""
    source = textwrap.dedent(inspect.getsource(rule))
    count = source.count(old)
    assert count == 1, f"{rule.__qualname__} has {count} times: {old}"
    changed = f"from __future__ import annotations\n{source.replace(old, new)}"
    found: dict[str, Any] = {}
    exec(compile(changed, f"<{rule.__name__}, broken>", "exec"), rule.__globals__, found)
    broken = found[rule.__name__]
    patch.setattr(rule, "__code__", getattr(broken, "fget", broken).__code__)


@pytest.mark.parametrize("broken", tuple(breaks()), ids=lambda each: each.name)
def test_a_broken_rule_is_found(broken: Break, monkeypatch: pytest.MonkeyPatch) -> None:
    broken.apply(monkeypatch)
    others = set()
    for seed in range(MOST_SEEDS):
        _, found = tried(seed)
        if found is not None and found.name == broken.found_by:
            return
        others |= {found.name} if found is not None else set()
    pytest.fail(f"{broken.found_by!r} breaks with none of {MOST_SEEDS} seeds, only {others}")
