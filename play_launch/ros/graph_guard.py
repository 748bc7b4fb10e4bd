"""rcl's guard condition for changes of the graph, which rclpy does not offer.

Every node of rcl has one, but rclpy neither exposes it nor waits for it (its ``wait_for_service``
sleeps and looks again). Its nodes and wait sets have their addresses, though, so rcl itself can put
the one into the other.
"""

from __future__ import annotations

import ctypes
from typing import TYPE_CHECKING, Any, Final

from rclpy.impl.implementation_singleton import rclpy_implementation

if TYPE_CHECKING:
    from rclpy.node import Node

_RCL_OK: Final = 0


class GraphGuardError(Exception):
    """This rclpy or rcl does not have what is needed; look at the graph now and then instead."""


class GraphGuard:
    """The guard condition of a node, which must outlive it.

    Raises ``GraphGuardError`` where it cannot be had.
    """

    def __init__(self, node: Node) -> None:
        try:
            # The extension is linked against rcl, so rcl's functions are found through it.
            rcl = ctypes.CDLL(rclpy_implementation.__file__)
            find = rcl.rcl_node_get_graph_guard_condition
            self._add = rcl.rcl_wait_set_add_guard_condition
            find.argtypes, find.restype = [ctypes.c_void_p], ctypes.c_void_p
            with node.handle:
                self._guard = find(node.handle.pointer)
        except (OSError, AttributeError) as error:
            raise GraphGuardError(str(error)) from error
        self._add.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.POINTER(ctypes.c_size_t)]
        self._add.restype = ctypes.c_int
        if not self._guard:
            raise GraphGuardError("the node has no guard condition for the graph")

    def add_to(self, wait_set: Any) -> int:
        """Put it into a wait set of rclpy's extension and return its index there.

        ``wait_set.is_ready("guard_condition", index)`` says after the wait whether the graph
        changed. Raises ``GraphGuardError`` when rcl refuses.
        """
        index = ctypes.c_size_t()
        code = self._add(wait_set.pointer, self._guard, ctypes.byref(index))
        if code != _RCL_OK:
            raise GraphGuardError(f"rcl_wait_set_add_guard_condition returned {code}")
        return index.value
