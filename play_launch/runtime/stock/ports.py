"""What the dialogue with a stock container needs of the outside world, and how long it waits."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Protocol

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable

    from play_launch.ros.composition import ListedNode, LoadReply, UnloadReply


class CompositionServices(Protocol):
    """The services of one container, as :mod:`play_launch.ros.composition` reaches them."""

    def on_graph_change(self, callback: Callable[[], None]) -> None:
        """Have this called after each change of the graph."""

    async def ready(self) -> None:
        """Wait until all of them are there."""

    async def is_ready(self) -> bool:
        """Whether they are there now."""

    async def graph_change(self) -> None:
        """Wait for the next change of the graph."""

    async def servers(self) -> frozenset[bytes]:
        """Identify those who answer; empty where that is unknown."""

    async def constructs_in_background(self) -> bool:
        """Whether it is known to answer while a constructor runs."""

    def list_nodes(self) -> asyncio.Future[tuple[ListedNode, ...]]:
        """Ask for all nodes."""

    def load_node(self, request: Any) -> asyncio.Future[LoadReply]:
        """Send a request that `encode` made."""

    def unload_node(self, unique_id: int) -> asyncio.Future[UnloadReply]:
        """Ask for a node's end."""

    def close(self) -> None:
        """Give up what is expected."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StockLimits:
    """Seconds."""

    first_list: float = 1.0
    """From the first question to a new container to the next; it doubles up to `list_nodes`."""
    list_nodes: float = 3.0
    """From a question for its nodes to the conclusion that it does not answer now."""
    unload_node: float = 10.0
    look: float = 5.0
    """Between two comparisons with the list while nothing is loaded."""
    silence: float = 10.0
    """Of a container that does not load anything; then it is reported, and nothing else is done."""
    waiting: float = 10.0
    """For a container of somebody else; then it is reported that it has not appeared."""
    lease: float = 30.0
    """After which a dead participant is forgotten by everybody."""


STOCK_LIMITS: Final = StockLimits()
