"""Parameters of the configuration as ROS messages; types are kept."""

from __future__ import annotations

from typing import Any

from play_launch.config.model import ParameterConfig, ParameterType

_FIELDS = {
    ParameterType.BOOL: "bool_value",
    ParameterType.INTEGER: "integer_value",
    ParameterType.DOUBLE: "double_value",
    ParameterType.STRING: "string_value",
    ParameterType.BYTE_ARRAY: "byte_array_value",
    ParameterType.BOOL_ARRAY: "bool_array_value",
    ParameterType.INTEGER_ARRAY: "integer_array_value",
    ParameterType.DOUBLE_ARRAY: "double_array_value",
    ParameterType.STRING_ARRAY: "string_array_value",
}


def to_parameter_message(parameter: ParameterConfig) -> Any:
    """Make a `rcl_interfaces/msg/Parameter`."""
    # Takes long.
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
    setattr(message.value, _FIELDS[parameter.value.type], value)
    return message
