"""The simulation can fail: it finds each deliberate break of a rule, by the invariant for it."""

from __future__ import annotations

import importlib
import pkgutil

import pytest

from . import breaks
from .search import tried

NAMES = sorted(each.name for each in pkgutil.iter_modules(breaks.__path__))
MOST_SEEDS = 600


def test_there_are_enough() -> None:
    assert len(NAMES) >= 25


@pytest.mark.parametrize("name", NAMES)
def test_a_broken_rule_is_found(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    module = importlib.import_module(f"{breaks.__name__}.{name}")
    module.apply(monkeypatch)
    others = set()
    for seed in range(MOST_SEEDS):
        _, found = tried(seed)
        if found is not None and found.name == module.FOUND_BY:
            return
        others |= {found.name} if found is not None else set()
    pytest.fail(f"{module.FOUND_BY!r} breaks with none of {MOST_SEEDS} seeds, only {others}")
