"""Values of our classes, for hypothesis."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

from hypothesis import strategies as st

Value = TypeVar("Value")


def structs(
    kind: Callable[..., Value], /, **fields: st.SearchStrategy[Any]
) -> st.SearchStrategy[Value]:
    """What `builds()` gives, also where annotations name what is imported for mypy only."""
    return st.fixed_dictionaries(fields).map(lambda values: kind(**values))
