"""Parameters of the configuration as ROS messages; types are kept."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from play_launch.config.model import ParameterConfig


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
