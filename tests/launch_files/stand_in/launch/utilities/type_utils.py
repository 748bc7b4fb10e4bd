"""Substitutions with a type."""

from __future__ import annotations

from typing import Any


def perform_typed_substitution(context: Any, value: Any, kind: Any) -> Any:
    return kind(value)
