"""Functions of the product that a test breaks on purpose."""

from __future__ import annotations

import inspect
import textwrap
from collections.abc import Callable
from typing import Any

import pytest


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
