"""The graph's own event, which rclpy does not offer: something appeared, or went away.

rcl has a guard condition for it in every node. rclpy neither exposes it nor waits for it (its
``wait_for_service`` sleeps and looks again), but its wait sets and nodes tell their addresses, so
that rcl itself can put the one into the other.
"""

from __future__ import annotations

import ctypes
from typing import TYPE_CHECKING, Any, Final

from rclpy.waitable import NumberOfEntities, Waitable

if TYPE_CHECKING:
    from collections.abc import Callable

    from rclpy.callback_groups import CallbackGroup
    from rclpy.node import Node

_LIBRARY: Final = "librcl.so"


class GraphEventsUnavailableError(Exception):
    """This rclpy or rcl does not have what is needed; look at the graph now and then instead."""


class GraphEvents(Waitable):
    """Calls back in the executor's thread after each change of the graph that a node sees."""

    def __init__(self, node: Node, group: CallbackGroup, on_change: Callable[[], None]) -> None:
        """Belong to a node; add it with ``node.add_waitable``.

        Raises:
            GraphEventsUnavailableError: Where the guard condition cannot be had.
        """
        super().__init__(group)  # type: ignore[no-untyped-call]
        self._on_change = on_change
        self._index: int | None = None
        try:
            rcl = ctypes.CDLL(_LIBRARY)
            find = rcl.rcl_node_get_graph_guard_condition
            self._add = rcl.rcl_wait_set_add_guard_condition
            address = node.handle.pointer
        except (OSError, AttributeError) as error:
            raise GraphEventsUnavailableError(str(error)) from error
        find.argtypes, find.restype = [ctypes.c_void_p], ctypes.c_void_p
        self._add.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.POINTER(ctypes.c_size_t)]
        self._add.restype = ctypes.c_int
        self._guard = find(address)
        if not self._guard:
            raise GraphEventsUnavailableError("rcl gives no guard condition for the graph")

    def get_num_entities(self) -> NumberOfEntities:
        """Tell the executor how much room to make."""
        return NumberOfEntities(num_gcs=1)  # type: ignore[no-untyped-call]

    def add_to_wait_set(self, wait_set: Any) -> None:
        """Put the guard condition into the executor's wait set."""
        index = ctypes.c_size_t()
        added = self._add(wait_set.pointer, self._guard, ctypes.byref(index)) == 0
        self._index = index.value if added else None

    def is_ready(self, wait_set: Any) -> bool:
        """Whether the graph has changed."""
        return self._index is not None and bool(wait_set.is_ready("guard_condition", self._index))

    def take_data(self) -> None:
        """There is none: waiting has reset the guard condition."""

    async def execute(self, _taken: None) -> None:
        """Pass it on."""
        self._on_change()
