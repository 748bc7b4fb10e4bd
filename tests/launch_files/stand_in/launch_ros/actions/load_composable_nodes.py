"""No composable nodes."""

from __future__ import annotations

from typing import Any


def get_composable_node_load_request(description: Any, context: Any) -> Any:
    raise NotImplementedError


def to_parameters_list(*_: Any) -> Any:
    raise NotImplementedError
