"""A node that looks at the graph: all that this package wants of rclpy is here."""

# rclpy is typed in parts only.
# mypy: disable-error-code="no-untyped-call,attr-defined"

from __future__ import annotations

import functools
import logging
import os
import threading
from typing import TYPE_CHECKING, Any, Final, NamedTuple
from uuid import uuid4

import rclpy
import rclpy.action
from rclpy.context import Context
from rclpy.node import Node
from rclpy.parameter import Parameter

from play_launch.graph_daemon.contract import GRAPH_METHODS, NODE_PREFIX
from play_launch.graph_daemon.server.marshal import to_wire
from play_launch.ros.fastdds.own_participant import as_our_own
from play_launch.ros.fastdds.waits import end_participants_safely
from play_launch.ros.waiting import Waiting

if TYPE_CHECKING:
    from collections.abc import Callable

    from play_launch.graph_daemon.server.service import Graph

_DISCOVERY_TOPIC: Final = "ros_discovery_info"
"""Every participant of ROS publishes here which nodes it has."""
_UNKNOWN_NODE: Final = "_NODE_NAME_UNKNOWN_"
_LOOK: Final = 0.5

_log = logging.getLogger(__name__)


def rmw_implementation() -> str:
    """Return the identifier of the middleware in use."""
    return str(rclpy.get_rmw_implementation_identifier())


class Met(NamedTuple):
    """Whom a participant has met."""

    participants: int
    """How many it knows, itself too; 0 with a middleware that does not show them."""
    nameless: int
    """How many publishers it knows whose nodes it does not know yet."""


class RosGraph:
    """A node in a context, so a DDS participant, of its own.

    Its name, parameters and topics are those of ros2cli's daemon. The methods may be called from
    any thread, `close` once.

    Args:
        domain: For the node's name; the domain itself is that of the environment.
        on_change: Called in a thread of the graph's own after each change of the graph, for a
            storm of changes once in `GRAPH_PAUSE`.
    """

    def __init__(self, domain: int, on_change: Callable[[], None]) -> None:
        self._on_change = on_change
        self._stopping = threading.Event()
        self._context = Context()
        try:
            with as_our_own(os.environ, rmw_implementation()):
                rclpy.init(args=[], context=self._context)
                end_participants_safely()
                self._node = Node(
                    f"{NODE_PREFIX}{domain}_{uuid4().hex}",
                    context=self._context,
                    start_parameter_services=False,
                    parameter_overrides=[
                        Parameter("use_sim_time", value=False),
                        Parameter("start_type_description_service", value=False),
                    ],
                    automatically_declare_parameters_from_overrides=True,
                )
            self._name = str(self._node.get_name())
            self._watch = Waiting(self._node, on_change)
        except BaseException:
            self._context.try_shutdown()
            raise
        self._thread = threading.Thread(target=self._run, name="graph", daemon=True)
        self._thread.start()

    @property
    def name(self) -> str:
        """The name of the node, without its namespace, which is the root."""
        return self._name

    def call(self, method: str, *arguments: object) -> Any:
        """Call one of `GRAPH_METHODS`; raises what rclpy raises."""
        return _function(self._node, method)(*arguments)

    def nodes(self) -> list[tuple[str, str]]:
        """Return name and namespace of every node, this one too."""
        return list(self._node.get_node_names_and_namespaces())

    def met(self) -> Met:
        """Return how far this participant has got to know the others."""
        participants = self._node.get_publishers_info_by_topic(_DISCOVERY_TOPIC, no_mangle=True)
        speakers = self._node.get_publishers_info_by_topic("/rosout")
        nameless = sum(speaker.node_name == _UNKNOWN_NODE for speaker in speakers)
        return Met(len(participants), nameless)

    def close(self) -> None:
        """Leave the graph."""
        self._stopping.set()
        self._watch.wake()
        self._thread.join()
        self._watch.close()
        self._node.destroy_node()
        self._context.try_shutdown()

    def _run(self) -> None:
        try:
            while not self._stopping.is_set():
                self._watch.wait()
        except Exception:  # noqa: BLE001 - in a thread it would go unnoticed
            _log.exception("changes of the graph are not reported; looking twice a second instead")
            while not self._stopping.wait(_LOOK):
                self._on_change()


_ACTION_FUNCTIONS: Final[dict[str, Any]] = {
    "get_action_names_and_types": rclpy.action.get_action_names_and_types,
    "get_action_server_names_and_types_by_node": (
        rclpy.action.get_action_server_names_and_types_by_node
    ),
    "get_action_client_names_and_types_by_node": (
        rclpy.action.get_action_client_names_and_types_by_node
    ),
}


def graph_functions(graph: Callable[[], Graph]) -> dict[str, Callable[..., Any]]:
    """Return the functions behind `GRAPH_METHODS`, as far as this rclpy has them.

    They look at whatever ``graph`` returns when they are called, carry rclpy's documentation, and
    answer in what XML-RPC can express.
    """
    functions: dict[str, Callable[..., Any]] = {}
    for method in GRAPH_METHODS:
        original = _ACTION_FUNCTIONS.get(method) or getattr(Node, method, None)
        if original is not None:
            functions[method] = _on_wire(method, original, graph)
    return functions


def _on_wire(
    method: str, original: Callable[..., Any], graph: Callable[[], Graph]
) -> Callable[..., Any]:
    # Only these answer in classes of rclpy; to look through all others would double their time.
    convert = to_wire if method.endswith("_info_by_topic") else _unchanged

    @functools.wraps(original)
    def function(*arguments: object) -> Any:
        return convert(graph().call(method, *arguments))

    return function


def _unchanged(value: object) -> object:
    return value


def _function(node: Node, method: str) -> Callable[..., Any]:
    action = _ACTION_FUNCTIONS.get(method)
    function: Callable[..., Any]
    function = functools.partial(action, node) if action else getattr(node, method)
    return function
