"""No parameters."""

from __future__ import annotations

from typing import Any


def evaluate_parameters(*_: Any) -> Any:
    raise NotImplementedError


def to_parameters_list(*_: Any) -> Any:
    raise NotImplementedError
