"""The messages of `play_launch_msgs`, and those of `rcl_interfaces` that they or we need.

The fields of the former, and what they mean, are in the interface definitions.
"""

from __future__ import annotations

from struct import Struct, error
from typing import Any, Final, NamedTuple

from play_launch.container.cdr.structure import CdrError, Layout, split_time, text_bytes

COMPONENT_EVENT: Final = Layout("ComponentEvent")
STATE_EVENT: Final = Layout("StateEvent")
GRAPH_ENDPOINT: Final = Layout("GraphEndpoint")
GRAPH_EVENT: Final = Layout("GraphEvent", GraphEndpoint=GRAPH_ENDPOINT)
ACTION_EVENT: Final = Layout("ActionEvent")
PROCESS_STATS: Final = Layout("ProcessStats")
GROUP_STATS: Final = Layout("GroupStats")
SYSTEM_STATS: Final = Layout("SystemStats")
CONTROL_HELLO: Final = Layout("ControlHello")
PARAMETER_VALUE: Final = Layout(
    "type:B bool_value:? integer_value:q double_value:d string_value:s byte_array_value:y "
    "bool_array_value:?[] integer_array_value:q[] double_array_value:d[] string_array_value:s[]"
)
PARAMETER: Final = Layout("name:s value:ParameterValue", ParameterValue=PARAMETER_VALUE)
NODE_PARAMETERS: Final = Layout("NodeParameters", Parameter=PARAMETER)
PARAMETER_EVENT: Final = Layout(
    "stamp:t node:s new_parameters:Parameter[] changed_parameters:Parameter[] "
    "deleted_parameters:Parameter[]",
    Parameter=PARAMETER,
)
CONTROL_LOAD: Final = Layout("ControlLoad", Parameter=PARAMETER)
CONTROL_ACCEPTED: Final = Layout("ControlAccepted")
CONTROL_REJECTED: Final = Layout("ControlRejected")
CONTROL_QUERY: Final = Layout("ControlQuery")
NODE_STATUS: Final = Layout("NodeStatus")
CONTROL_STATUS: Final = Layout("ControlStatus", NodeStatus=NODE_STATUS)
CONTROL_CANCEL: Final = Layout("ControlCancel")
CONTROL_UNLOAD: Final = Layout("ControlUnload")
CONTROL_SHUTDOWN: Final = Layout("ControlShutdown")
LOG: Final = Layout("stamp:t level:B name:s msg:s file:s function:s line:I")
"""Written by `log_message`, where there may be many."""

_LOG_HEAD: Final = Struct("<4siIB3xI")
"""Encapsulation (little-endian CDR), stamp, level, and the length of the first string."""
_LENGTH: Final = Struct("<I")
_PERCENT: Final = Struct("<12xd")
"""What precedes the sequences of a SystemStats, with its encapsulation."""
_FIGURES: Final = Struct("<QQ24xQ24xd")
"""Of what follows them: the names are in `read_machine`."""
_ENCAPSULATION: Final = b"\x00\x01\x00\x00"
_PADDING: Final = (b"\0", b"\0\0\0\0", b"\0\0\0", b"\0\0")
"""A string's terminator and the padding to the next 4 bytes, by its length modulo 4 with it."""


def log_message(
    stamp_ns: int,
    level: int,
    name: str,
    message: str,
    *,
    file: str = "",
    function: str = "",
    line: int = 0,
) -> bytes:
    """Serialise one ``rcl_interfaces/Log``; ``stamp_ns`` is in nanoseconds since the epoch.

    Lines of output arrive in tens of thousands a second, so they have a function of their own: 1 us
    a line, where rclpy's serialiser takes 4 us.

    A stamp that ``builtin_interfaces/Time`` cannot hold becomes the nearest one it can.
    """
    seconds, nanoseconds = split_time(stamp_ns)
    a, b, c, d = text_bytes(name), text_bytes(message), text_bytes(file), text_bytes(function)
    size_a, size_b, size_c, size_d = len(a) + 1, len(b) + 1, len(c) + 1, len(d) + 1
    pack = _LENGTH.pack
    return b"".join(
        (
            _LOG_HEAD.pack(_ENCAPSULATION, seconds, nanoseconds, level, size_a),
            a,
            _PADDING[size_a & 3],
            pack(size_b),
            b,
            _PADDING[size_b & 3],
            pack(size_c),
            c,
            _PADDING[size_c & 3],
            pack(size_d),
            d,
            _PADDING[size_d & 3],
            pack(line),
        )
    )


class LogFields(NamedTuple):
    """What a ``rcl_interfaces/Log`` holds, up to its text."""

    stamp_ns: int
    level: int
    name: str
    message: str


def read_log(data: bytes) -> LogFields:
    """Read the beginning of what `log_message` writes, in a fifth of the time of `LOG.read`.

    Raises:
        CdrError: When it is no such message.
    """
    try:
        head, seconds, nanoseconds, level, size = _LOG_HEAD.unpack_from(data)
        at = _LOG_HEAD.size + size
        name = data[_LOG_HEAD.size : data.index(0, _LOG_HEAD.size, at)]
        at += -at % 4
        (size,) = _LENGTH.unpack_from(data, at)
        at += _LENGTH.size
        message = data[at : data.index(0, at, at + size)]
    except (error, ValueError) as reason:
        raise CdrError(str(reason)) from reason
    if head[:2] != _ENCAPSULATION[:2]:
        raise CdrError("it does not begin as little-endian CDR")
    stamp_ns = seconds * 1_000_000_000 + nanoseconds
    text = message.decode("utf-8", "replace")
    return LogFields(stamp_ns, level, name.decode("utf-8", "replace"), text)


def read_machine(data: bytes) -> dict[str, Any] | None:
    """Read of a SystemStats what is judged, in a tenth of the time of `SYSTEM_STATS.read`.

    None for another message.
    """
    names = ("memory_total", "memory_available", "disk_free", "cpu_some_avg10")
    try:
        (percent,) = _PERCENT.unpack_from(data)
        at = _PERCENT.size
        for _ in range(2):  # a sequence for the load of each core, and for its frequency
            (count,) = _LENGTH.unpack_from(data, at)
            at += _LENGTH.size
            at += count and (4 - at) % 8 + 8 * count  # aligned behind the encapsulation
        figures = _FIGURES.unpack_from(data, at + (4 - at) % 8)
    except error:
        return None
    return {"cpu_percent": percent, **dict(zip(names, figures, strict=True))}
