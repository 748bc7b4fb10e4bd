"""The graph's own event for rclpy's executors: something appeared, or went away."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rclpy.waitable import NumberOfEntities, Waitable

from play_launch.ros.graph_guard import GraphGuard, GraphGuardError

if TYPE_CHECKING:
    from collections.abc import Callable

    from rclpy.callback_groups import CallbackGroup
    from rclpy.node import Node


class GraphEvents(Waitable):
    """Calls back in the executor's thread after each change of the graph that a node sees."""

    def __init__(self, node: Node, group: CallbackGroup, on_change: Callable[[], None]) -> None:
        """Belong to a node; add it with ``node.add_waitable``.

        Raises:
            GraphGuardError: Where the guard condition cannot be had.
        """
        super().__init__(group)  # type: ignore[no-untyped-call]
        self._on_change = on_change
        self._index: int | None = None
        self._guard = GraphGuard(node)

    def get_num_entities(self) -> NumberOfEntities:
        """Return how much room the executor is to make."""
        return NumberOfEntities(num_gcs=1)  # type: ignore[no-untyped-call]

    def add_to_wait_set(self, wait_set: Any) -> None:
        """Put the guard condition into the executor's wait set."""
        try:
            self._index = self._guard.add_to(wait_set)
        except GraphGuardError:
            self._index = None

    def is_ready(self, wait_set: Any) -> bool:
        """Whether the graph has changed."""
        return self._index is not None and bool(wait_set.is_ready("guard_condition", self._index))

    def take_data(self) -> None:
        """There is none: waiting has reset the guard condition."""

    async def execute(self, _taken: None) -> None:
        """Pass it on."""
        self._on_change()
