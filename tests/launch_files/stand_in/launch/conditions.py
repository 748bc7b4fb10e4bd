"""Conditions."""

from __future__ import annotations

from typing import Any


def evaluate_condition_expression(context: Any, expression: Any) -> bool:
    return "".join(each.perform(context) for each in expression).lower() in {"true", "1"}
