"""Values of our classes, for hypothesis."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeVar

from hypothesis import strategies as st

if TYPE_CHECKING:
    from collections.abc import Callable

Value = TypeVar("Value")


def structs(
    kind: Callable[..., Value], /, **fields: st.SearchStrategy[Any]
) -> st.SearchStrategy[Value]:
    """What `builds()` gives, also where annotations name what is imported for mypy only."""
    return st.fixed_dictionaries(fields).map(lambda values: kind(**values))
