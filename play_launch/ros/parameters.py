"""Parameters of the configuration as ROS messages, and setting them in running nodes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import anyio

from play_launch.ros.thread import RosThread, node_pool

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from play_launch.config.model import ParameterConfig

FIND_LIMIT: Final = 10.0
"""Seconds until a node counts as one that has no parameter services. DDS takes up to three to
introduce a new participant to existing ones where its transport is the user's, and longer on a busy
machine; after a shorter timeout, nodes would be reloaded without need."""
ANSWER_LIMIT: Final = 3.0
"""Seconds for the answer of a service that exists."""


class ParameterSetter:
    """Sets parameters of running nodes; keeps its nodes of the pool until it is closed.

    Belongs to the event loop's thread.
    """

    def __init__(self) -> None:
        self._used: set[RosThread] = set()

    async def set(
        self, node: str, parameters: Sequence[ParameterConfig], environment: Mapping[str, str]
    ) -> str:
        """Set all of them or none; return why not."""
        try:
            ros = node_pool.acquire(environment)
            if ros in self._used:
                node_pool.release(ros)
            self._used.add(ros)
            return await _set(ros, node, parameters)
        except Exception as error:  # noqa: BLE001 - whatever prevents it, a reload is possible
            return f"its parameters cannot be set: {error}"

    async def close(self) -> None:
        """Release the nodes."""
        used, self._used = self._used, set()
        for thread in used:
            await node_pool.leave(thread)


async def _set(ros: RosThread, node: str, parameters: Sequence[ParameterConfig]) -> str:
    # Takes long, and is needed for changes only.
    from rcl_interfaces.srv import SetParametersAtomically  # noqa: PLC0415

    service = f"{node}/set_parameters_atomically"
    client: Any = await ros.call(lambda ours: ours.create_client(SetParametersAtomically, service))
    try:
        with anyio.move_on_after(FIND_LIMIT) as finding:
            await ros.until(lambda _: client.service_is_ready())
        if finding.cancelled_caught:
            return f"its parameter service is not found within {FIND_LIMIT:g} s"
        request = SetParametersAtomically.Request()
        request.parameters = [to_parameter_message(each) for each in parameters]
        with anyio.move_on_after(ANSWER_LIMIT) as asking:
            answer = await ros.request(lambda _: client, lambda _: request)
        if asking.cancelled_caught:
            return f"its parameter service does not answer within {ANSWER_LIMIT:g} s"
    finally:
        ros.post(lambda ours: _destroy(ours, client))
    if answer.result.successful:
        return ""
    return answer.result.reason or "it refuses the parameters"


def _destroy(ours: Any, client: Any) -> None:
    ours.destroy_client(client)


def to_parameter_message(parameter: ParameterConfig) -> Any:
    """Make a `rcl_interfaces/msg/Parameter`."""
    # Takes long, and is for stock containers only.
    from rcl_interfaces.msg import Parameter  # noqa: PLC0415
    from rcl_interfaces.msg import ParameterValue as ParameterValueMessage  # noqa: PLC0415

    message = Parameter(check_fields=True)
    message.name = parameter.name
    message.value = ParameterValueMessage(check_fields=True)
    message.value.type = int(parameter.value.type)
    value: Any = parameter.value.value
    if isinstance(value, bytes):
        value = [bytes((byte,)) for byte in value]
    elif isinstance(value, tuple):
        value = list(value)
    setattr(message.value, parameter.value.type.field, value)
    return message
