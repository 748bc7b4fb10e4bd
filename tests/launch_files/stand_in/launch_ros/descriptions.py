"""No composable nodes."""

from __future__ import annotations

from typing import Any


class ComposableNode:
    @classmethod
    def parse(cls, parser: Any, entity: Any) -> Any:
        raise NotImplementedError
