"""Services and parameters of running nodes for a command, over a node of its own; blocks."""

from __future__ import annotations

import os
import time
from typing import TYPE_CHECKING, Any, Final, Self

from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import GetParameters, ListParameters, SetParameters
from rclpy.parameter import get_parameter_value, parameter_value_to_python

from play_launch.ros.thread import open_node
from play_launch.ros.waiting import Waiter

if TYPE_CHECKING:
    from collections.abc import Callable

_SLICE: Final = 0.1
_DEPTH: Final = 100
"""Messages of a topic that wait to be taken."""
"""Seconds of one wait for ROS."""


class NodeServiceError(Exception):
    """A node did not answer; the text says which one."""


class NodeServices:
    """Speaks ROS in the environment of this process. It belongs to one thread."""

    def __init__(self) -> None:
        self._context, self._node, _ = open_node(f"_play_launch_command_{os.getpid()}")
        self._waiting = Waiter(self._node, lambda: None)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._waiting.close()
        self._node.destroy_node()  # type: ignore[no-untyped-call]
        self._context.try_shutdown()

    def call(self, node: str, service: str, kind: Any, request: Any, limit: float) -> Any:
        """Call ``<node>/<service>`` of that type and return the response.

        Raises NodeServiceError when there is no such service, or no answer within ``limit``
        seconds.
        """
        deadline = time.monotonic() + limit
        client = self._node.create_client(kind, f"{node}/{service}")
        try:
            if not self.until(client.service_is_ready, deadline):
                raise NodeServiceError(
                    f"{node} offers no {service} in ROS domain "
                    f"{os.environ.get('ROS_DOMAIN_ID') or 0}"
                )
            answer = client.call_async(request)
            if not self.until(answer.done, deadline):
                raise NodeServiceError(f"{node} did not answer {service} within {limit:g} s")
            return answer.result()  # type: ignore[no-untyped-call]
        finally:
            self._node.destroy_client(client)

    def publisher(self, kind: Any, topic: str) -> Callable[[Any], None]:
        """Return what publishes a message of that type."""
        publish: Callable[[Any], None] = self._node.create_publisher(kind, topic, 10).publish
        return publish

    def subscribe(self, kind: Any, topic: str, take: Callable[[Any], None]) -> None:
        """Hand over each message of that type, while `until` runs."""
        self._node.create_subscription(kind, topic, take, _DEPTH)

    def now(self) -> Any:
        """Return the time as ``builtin_interfaces/Time``."""
        return self._node.get_clock().now().to_msg()

    def nodes(self) -> set[str]:
        """Full names of the nodes that are seen in the graph by now."""
        found = self._node.get_node_names_and_namespaces()
        return {f"{namespace.rstrip('/')}/{name}" for name, namespace in found}

    def services(self) -> dict[str, list[str]]:
        """Names of the services that are seen by now, with their types."""
        return dict(self._node.get_service_names_and_types())

    def until(self, is_so: Callable[[], bool], deadline: float) -> bool:
        """Spin until something is so; False when the monotonic clock comes to ``deadline``."""
        while not is_so():
            left = deadline - time.monotonic()
            if left <= 0:
                return False
            self._waiting.wait(min(left, _SLICE))
        return True


class ParameterClient(NodeServices):
    """Parameters of running nodes as plain values; types are kept."""

    def __init__(self, limit: float) -> None:
        """Give each call so many seconds."""
        super().__init__()
        self._limit = limit

    def get(self, node: str, names: list[str]) -> dict[str, Any]:
        """Read parameters.

        Raises NodeServiceError when the node does not answer, and ValueError when it has no such
        parameter.
        """
        values = self._values(node, names)
        missing = [name for name, value in values.items() if _is_not_set(value)]
        if missing:
            raise ValueError(f"{node} has no parameter {', '.join(missing)}")
        return {name: _plain(value) for name, value in values.items()}

    def dump(self, node: str) -> dict[str, Any]:
        """Read all parameters of a node, sorted; those without a value are left out.

        Raises NodeServiceError when the node does not answer.
        """
        request = ListParameters.Request()
        answer = self.call(node, "list_parameters", ListParameters, request, self._limit)
        listed = answer.result.names
        values = self._values(node, sorted(listed))
        return {name: _plain(value) for name, value in values.items() if not _is_not_set(value)}

    def set(self, node: str, name: str, text: str) -> None:
        """Set a parameter to what a text means as the type that it has.

        Raises NodeServiceError when the node does not answer, and ValueError when the text is of
        another type, or the node refuses it.
        """
        now = self._values(node, [name])[name]
        value = typed(text, int(now.type))
        request = SetParameters.Request(parameters=[Parameter(name=name, value=value)])
        answer = self.call(node, "set_parameters", SetParameters, request, self._limit)
        result = answer.results[0]
        if not result.successful:
            raise ValueError(f"{node} refuses {name}: {result.reason or 'without a reason'}")

    def _values(self, node: str, names: list[str]) -> dict[str, Any]:
        request = GetParameters.Request(names=names)
        values = self.call(node, "get_parameters", GetParameters, request, self._limit).values
        # A node answers with nothing at all where one of them is not declared.
        found = values if len(values) == len(names) else [ParameterValue()] * len(names)
        return dict(zip(names, found, strict=True))


def typed(text: str, kind: int) -> Any:
    """Read a text as a value of a type, a number of `ParameterType`; NOT_SET: as YAML has it.

    Raises ValueError where it is not of that type.
    """
    if kind == ParameterType.PARAMETER_STRING:
        return ParameterValue(type=kind, string_value=text)
    value = get_parameter_value(text)
    if kind in {ParameterType.PARAMETER_NOT_SET, value.type}:
        return value
    if (kind, value.type) == (
        ParameterType.PARAMETER_DOUBLE,
        ParameterType.PARAMETER_INTEGER,
    ):
        return ParameterValue(type=kind, double_value=float(value.integer_value))
    if (kind, value.type) == (
        ParameterType.PARAMETER_DOUBLE_ARRAY,
        ParameterType.PARAMETER_INTEGER_ARRAY,
    ):
        numbers = [float(each) for each in value.integer_array_value]
        return ParameterValue(type=kind, double_array_value=numbers)
    raise ValueError(f"{text} is {_NAMES[value.type]}, and the parameter is {_NAMES[kind]}")


_NAMES = {
    ParameterType.PARAMETER_NOT_SET: "nothing",
    ParameterType.PARAMETER_BOOL: "a bool",
    ParameterType.PARAMETER_INTEGER: "an integer",
    ParameterType.PARAMETER_DOUBLE: "a double",
    ParameterType.PARAMETER_STRING: "a string",
    ParameterType.PARAMETER_BYTE_ARRAY: "an array of bytes",
    ParameterType.PARAMETER_BOOL_ARRAY: "an array of bools",
    ParameterType.PARAMETER_INTEGER_ARRAY: "an array of integers",
    ParameterType.PARAMETER_DOUBLE_ARRAY: "an array of doubles",
    ParameterType.PARAMETER_STRING_ARRAY: "an array of strings",
}


def _is_not_set(value: Any) -> bool:
    return bool(value.type == ParameterType.PARAMETER_NOT_SET)


def _plain(value: Any) -> Any:
    found = parameter_value_to_python(value)
    if value.type == ParameterType.PARAMETER_BYTE_ARRAY:
        return [each[0] for each in found]
    return found if found is None or isinstance(found, bool | int | float | str) else list(found)
