"""Asking a container that answers late, or not at all."""

from __future__ import annotations

import asyncio
import logging
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from collections.abc import Callable

    from play_launch.ros.composition import ListedNode
    from play_launch.runtime.stock.ports import CompositionServices, StockLimits

_log = logging.getLogger(__name__)

_FIRST_LISTS: Final = 8
"""How many first questions may be open."""
_BREATH: Final = 0.05
"""Seconds from one of them to the next at least: while the graph changes, it changes a lot."""


async def first_list(services: CompositionServices, limits: StockLimits) -> tuple[ListedNode, ...]:
    """Ask a new container for its nodes until it answers.

    The services of one that has just been killed are still in the graph, so the first questions may
    have gone to nobody. ListNodes may be asked any number of times.
    """
    asked: list[asyncio.Future[Any]] = []
    pause = limits.first_list
    try:
        while True:
            asked.append(services.list_nodes())
            changed = asyncio.ensure_future(services.graph_change())
            try:
                await asyncio.sleep(_BREATH)
                await asyncio.wait(
                    [*asked, changed], timeout=pause, return_when=asyncio.FIRST_COMPLETED
                )
            finally:
                changed.cancel()
            for future in asked:
                if future.done():
                    nodes: tuple[ListedNode, ...] = future.result()
                    return nodes
            pause = min(2 * pause, limits.list_nodes)
            while len(asked) > _FIRST_LISTS:
                asked.pop(0).cancel()
    finally:
        for future in asked:
            future.cancel()


class Silence:
    """How long a container has not answered, reported once; ``clock`` is the event loop's."""

    def __init__(self, name: str, limit: float, clock: Callable[[], float]) -> None:
        """Begin now; silence is reported after ``limit`` seconds."""
        self._name = name
        self._limit = limit
        self._clock = clock
        self._heard_at = clock()
        self._is_reported = False

    def heard(self) -> None:
        """It has answered."""
        self._heard_at = self._clock()
        if self._is_reported:
            self._is_reported = False
            _log.warning("%s answers again", self._name)

    def report(self) -> None:
        """It did not answer, and loads nothing that would explain it."""
        silent = self._clock() - self._heard_at
        if silent <= self._limit or self._is_reported:
            return
        self._is_reported = True
        _log.warning(
            "%s has not answered for %.0f s: its executor is busy, or it is frozen",
            self._name,
            silent,
        )
