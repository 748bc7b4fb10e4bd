"""Nodes that take parameters, or refuse them."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from play_launch.ros.parameters import ParameterSetter

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from play_launch.config.model import ParameterConfig


@dataclass
class FakeParameters(ParameterSetter):
    """Sets everything but what is refused, with the reason."""

    refusals: dict[str, str] = field(default_factory=dict)
    taken: list[tuple[str, str, object]] = field(default_factory=list)

    async def set(
        self, node: str, parameters: Sequence[ParameterConfig], environment: Mapping[str, str]
    ) -> str:
        await asyncio.sleep(0.01)
        if node in self.refusals:
            return self.refusals[node]
        self.taken += [(node, each.name, each.value.value) for each in parameters]
        return ""

    async def close(self) -> None:
        pass
