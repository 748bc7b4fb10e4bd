"""Substitutions, performed."""

from __future__ import annotations

from typing import Any

from launch.substitutions import TextSubstitution


def normalize_to_list_of_substitutions(value: Any) -> list[Any]:
    values = value if isinstance(value, list | tuple) else [value]
    return [TextSubstitution(text=each) if isinstance(each, str) else each for each in values]


def perform_substitutions(context: Any, substitutions: Any) -> str:
    return "".join(each.perform(context) for each in substitutions)
