"""The node that queries the graph: all uses of rclpy in this package."""

# rclpy is typed in parts only.
# mypy: disable-error-code="no-untyped-call,attr-defined"

from __future__ import annotations

import contextlib
import functools
import importlib
import logging
import os
import threading
from collections import Counter
from typing import TYPE_CHECKING, Any, Final
from uuid import uuid4

import rclpy
import rclpy.action
import rclpy.qos
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.node import Node, NodeNameNonExistentError
from rclpy.parameter import Parameter
from rclpy.topic_endpoint_info import TopicEndpointInfo, TopicEndpointTypeEnum

from play_launch.graph_daemon.contract import GRAPH_METHODS, NODE_PREFIX
from play_launch.graph_daemon.xml_rpc import register_scalar, register_struct
from play_launch.ros.fastdds.own_participant import as_our_own, made_safely
from play_launch.ros.waiting import Waiter
from play_launch.supervisor.endpoints import UNCHECKED

if TYPE_CHECKING:
    from collections.abc import Callable

_DISCOVERY_TOPIC: Final = "ros_discovery_info"
"""Every participant of ROS publishes here which nodes it has."""
_UNKNOWN_NODE: Final = "_NODE_NAME_UNKNOWN_"
_LOOK: Final = 0.5
_NO_LIMIT: Final = (2**31 - 1) * 1_000_000_000
"""Nanoseconds; DDS reports what is infinite as this, or as a little more."""

_log = logging.getLogger(__name__)


def rmw_implementation() -> str:
    """Return the identifier of the middleware in use."""
    return str(rclpy.get_rmw_implementation_identifier())


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
            with as_our_own(os.environ, rmw_implementation()) as chosen:
                rclpy.init(args=[], context=self._context)
                with made_safely(chosen):
                    self.node = Node(
                        f"{NODE_PREFIX}{domain}_{uuid4().hex}",
                        context=self._context,
                        start_parameter_services=False,
                        parameter_overrides=[
                            Parameter("use_sim_time", value=False),
                            Parameter("start_type_description_service", value=False),
                        ],
                        automatically_declare_parameters_from_overrides=True,
                    )
            self.name = str(self.node.get_name())
            """Without its namespace, which is the root."""
            self._watch = Waiter(self.node, on_change)
        except BaseException:
            self._context.try_shutdown()
            raise
        self._thread = threading.Thread(target=self._run, name="graph", daemon=True)
        self._thread.start()

    def nodes(self) -> list[tuple[str, str]]:
        return list(self.node.get_node_names_and_namespaces())

    def met(self) -> tuple[int, int]:
        """Count what this participant has discovered.

        Returns the participants, itself included (0 with a middleware that does not show them), and
        the publishers whose nodes are not known yet.
        """
        participants = self.node.get_publishers_info_by_topic(_DISCOVERY_TOPIC, no_mangle=True)
        speakers = self.node.get_publishers_info_by_topic("/rosout")
        nameless = sum(speaker.node_name == _UNKNOWN_NODE for speaker in speakers)
        return len(participants), nameless

    def endpoints(self) -> list[tuple[object, ...]]:
        """Give all publishers and subscriptions whose nodes are known, field by field."""
        node = self.node
        return [
            (topic, *_endpoint(each))
            for topic, _ in node.get_topic_names_and_types()
            if topic not in UNCHECKED
            for find in (node.get_publishers_info_by_topic, node.get_subscriptions_info_by_topic)
            for each in find(topic)
            if each.node_name != _UNKNOWN_NODE
        ]

    def unserved_services(self) -> list[tuple[str, list[str]]]:
        """Give name and types of each service that has clients and no server."""
        node = self.node
        return [
            (name, types)
            for name, types in node.get_service_names_and_types()
            if node.count_clients(name) and not node.count_services(name)
        ]

    def doubtful(self) -> frozenset[tuple[str, str]]:
        """Give the nodes without any endpoint, and the names that several nodes have.

        The nodes of a participant that ends while it announces them may stay in the graph for good:
        the middleware forgets the participant first, and then takes what it had announced.
        """
        times = Counter(self.nodes())
        return frozenset(
            each for each, count in times.items() if count > 1 or not self._has_endpoints(*each)
        )

    def _has_endpoints(self, name: str, namespace: str) -> bool:
        node = self.node
        try:
            return any(
                find(name, namespace)
                for find in (
                    node.get_publisher_names_and_types_by_node,
                    node.get_subscriber_names_and_types_by_node,
                    node.get_service_names_and_types_by_node,
                    node.get_client_names_and_types_by_node,
                )
            )
        except NodeNameNonExistentError:  # it has gone since it was listed
            return True

    def close(self) -> None:
        self._stopping.set()
        self._watch.wake()
        self._thread.join()
        self._watch.close()
        self.node.destroy_node()
        self._context.try_shutdown()

    def _run(self) -> None:
        try:
            while not self._stopping.is_set():
                self._watch.wait()
        except Exception:  # noqa: BLE001 - in a thread it would go unnoticed
            _log.exception("changes of the graph are not reported; looking twice a second instead")
            while not self._stopping.wait(_LOOK):
                self._on_change()


def _endpoint(info: TopicEndpointInfo) -> tuple[object, ...]:
    qos = info.qos_profile
    return (
        f"{info.node_namespace.rstrip('/')}/{info.node_name}",
        info.topic_type,
        info.endpoint_type is TopicEndpointTypeEnum.PUBLISHER,
        qos.reliability.value,
        qos.durability.value,
        qos.liveliness.value,
        *(
            each.nanoseconds if each.nanoseconds < _NO_LIMIT else 0
            for each in (qos.deadline, qos.liveliness_lease_duration)
        ),
    )


def graph_functions(graph: Callable[[], RosGraph]) -> dict[str, Callable[..., Any]]:
    """Return the functions behind `GRAPH_METHODS` that this rclpy has.

    They query whatever ``graph`` returns when they are called, and carry rclpy's documentation.
    """

    def forwarded(original: Callable[..., Any]) -> Callable[..., Any]:
        @functools.wraps(original)
        def function(*arguments: object) -> Any:
            return original(graph().node, *arguments)

        return function

    functions: dict[str, Callable[..., Any]] = {}
    for method in GRAPH_METHODS:
        original = getattr(rclpy.action, method, None) or getattr(Node, method, None)
        if original is not None:
            functions[method] = forwarded(original)
    return functions


def _register_values() -> None:
    """Have the values of rclpy written as ros2cli's daemon writes them; Humble has no TypeHash."""
    register_scalar(Duration, lambda value: value.nanoseconds)
    for name in ("HistoryPolicy", "ReliabilityPolicy", "DurabilityPolicy", "LivelinessPolicy"):
        register_scalar(getattr(rclpy.qos, name), lambda value: value.value)
    register_scalar(TopicEndpointTypeEnum, lambda value: value.value)
    register_struct(rclpy.qos.QoSProfile)
    register_struct(TopicEndpointInfo)
    with contextlib.suppress(ImportError):
        register_struct(importlib.import_module("rclpy.type_hash").TypeHash)


_register_values()
