"""The wait of our own nodes: for answers, messages, changes of the graph, and being woken.

rclpy's executors make a wait set and tasks anew each time. While a system comes up its graph
changes a thousand times and answers come in between, which took more CPU than all the rest of the
supervisor.
"""

from __future__ import annotations

import ctypes
import math
import time
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Final

from rclpy.impl.implementation_singleton import rclpy_implementation

if TYPE_CHECKING:
    from collections.abc import Callable

    from rclpy.node import Node

GRAPH_PAUSE: Final = 0.05
"""Seconds from one report of changes of the graph to the next at least."""
GRAPH_POLL: Final = 0.25
"""Seconds between two looks at the graph where its event cannot be had."""
_FOR_EVER: Final = -1
_RCL_OK: Final = 0


class GraphGuardError(Exception):
    """This rclpy or rcl lacks what is needed; the graph is polled instead."""


class GraphGuard:
    """rcl's guard condition for changes of the graph, of a node that must outlive it.

    Every node of rcl has one, but rclpy neither exposes it nor waits for it (its
    ``wait_for_service`` polls). Its nodes and wait sets have their addresses, though, so rcl itself
    can put the one into the other. Raises ``GraphGuardError`` where that is not possible.
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


class Waiter:
    """Waits in the thread that a node belongs to, for its clients and subscriptions."""

    def __init__(self, node: Node, on_graph_change: Callable[[], None]) -> None:
        """Wait for what this node has at the time."""
        self._node = node
        self._on_graph_change = on_graph_change
        self._wake: Any = node.create_guard_condition(lambda: None)
        self._graph: GraphGuard | None = None
        with suppress(GraphGuardError):
            self._graph = GraphGuard(node)
        self._look_at = 0.0
        """Until then changes of the graph end no wait."""
        self._set: Any = None
        self._room = (0, 0)

    def wake(self) -> None:
        """End the wait, or the next one; from any thread."""
        self._wake.trigger()

    def wait(self, limit: float = math.inf) -> None:
        """Wait for so many seconds at most, and pass answers and messages to their callbacks.

        Raises what keeps one of them from being read, or goes wrong in a subscription's callback.
        """
        clients, subscriptions = list(self._node.clients), list(self._node.subscriptions)
        waits = self._emptied_set(len(subscriptions), len(clients))
        for subscription in subscriptions:
            waits.add_subscription(subscription.handle)
        for client in clients:
            waits.add_client(client.handle)
        waits.add_guard_condition(self._wake.handle)
        pause = self._look_at - time.monotonic()
        graph = self._add_graph(waits) if pause <= 0 else None
        # Lets other threads of Python run meanwhile.
        left = limit if graph is not None else min(limit, max(0.0, pause))
        waits.wait(_FOR_EVER if math.isinf(left) else round(left * 1e9))
        if pause <= 0 and (graph is None or waits.is_ready("guard_condition", graph)):
            self._look_at = time.monotonic() + (GRAPH_POLL if graph is None else GRAPH_PAUSE)
            self._on_graph_change()
        for client in _those_of(clients, waits.get_ready_entities("client")):
            header, response = client.handle.take_response(client.srv_type.Response)
            if header is not None:
                with suppress(KeyError):  # given up in the meantime
                    expected = client.get_pending_request(header.request_id.sequence_number)
                    expected.set_result(response)
        for subscription in _those_of(subscriptions, waits.get_ready_entities("subscription")):
            taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
            if taken is not None:
                subscription.callback(taken[0])

    def close(self) -> None:
        """Free what the node does not; before the node ends."""
        if self._set is not None:
            self._set.destroy_when_not_in_use()
            self._set = None

    def _emptied_set(self, subscriptions: int, clients: int) -> Any:
        if self._set is None or self._room != (subscriptions, clients):
            self.close()
            handle: Any = self._node.context.handle
            with handle:
                self._set = rclpy_implementation.WaitSet(subscriptions, 2, 0, clients, 0, 0, handle)
            self._room = (subscriptions, clients)
        self._set.clear_entities()
        return self._set

    def _add_graph(self, waits: Any) -> int | None:
        if self._graph is not None:
            with suppress(GraphGuardError):
                return self._graph.add_to(waits)
        return None


def _those_of(entities: list[Any], pointers: list[int]) -> list[Any]:
    return [each for each in entities if each.handle.pointer in pointers] if pointers else []
