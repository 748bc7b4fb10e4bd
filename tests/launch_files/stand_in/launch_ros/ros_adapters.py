"""No node of its own."""

from __future__ import annotations

from typing import Any


def get_ros_adapter(context: Any) -> Any:
    raise NotImplementedError
