"""A client that looks closely: plain http and xml, tags and all."""

from __future__ import annotations

import http.client
import re
import xmlrpc.client
from collections.abc import Callable
from typing import Any, ClassVar

from play_launch.graph_daemon.contract import PATH, DaemonAddress

_VOLATILE = (
    (re.compile(r"_ros2cli_daemon_\d+_[0-9a-f]{32}"), "OWN_NAME"),
    (re.compile(r", at /[^ ]*:\d+"), ", at SOURCE"),
    (re.compile(r"object at 0x[0-9a-f]+"), "object at ADDRESS"),
)
UNORDERED = re.compile(r"get_.*(names|info)|get_node")


def request_body(method: str, arguments: list[Any]) -> bytes:
    return xmlrpc.client.dumps(tuple(arguments), method, allow_none=True).encode()


def post(
    address: DaemonAddress, body: bytes, *, path: str = PATH, timeout: float = 60.0
) -> tuple[int, bytes]:
    """Send one request and return the status and the body of the answer."""
    connection = http.client.HTTPConnection(address.host, address.port, timeout=timeout)
    try:
        connection.request("POST", path, body, {"Content-Type": "text/xml"})
        answer = connection.getresponse()
        return answer.status, answer.read()
    finally:
        connection.close()


def ask(address: DaemonAddress, method: str, *arguments: Any) -> Any:
    """Call a method with Python's own client; the answer must hold nothing but plain XML-RPC."""
    with xmlrpc.client.ServerProxy(address.url, allow_none=True) as proxy:
        return getattr(proxy, method)(*arguments)


STRUCTS = (
    "rclpy.qos.QoSProfile",
    "rclpy.topic_endpoint_info.TopicEndpointInfo",
    "rclpy.type_hash.TypeHash",
)
SCALARS = (
    "rclpy.duration.Duration",
    "rclpy.qos.HistoryPolicy",
    "rclpy.qos.ReliabilityPolicy",
    "rclpy.qos.DurabilityPolicy",
    "rclpy.qos.LivelinessPolicy",
    "rclpy.topic_endpoint_info.TopicEndpointTypeEnum",
)


class TaggedReader(xmlrpc.client.Unmarshaller):
    """Reads elements named like Python classes as pairs of their name and value."""

    dispatch: ClassVar[dict[str, Any]] = dict(  # type: ignore[misc]
        xmlrpc.client.Unmarshaller.dispatch
    )


def _end_of(tag: str) -> Callable[[Any, str], None]:
    def end(reader: Any, text: str) -> None:
        # A struct has been put on the stack by its own element.
        value = reader._stack.pop() if tag in STRUCTS else text
        reader._stack.append([tag, value])
        reader._value = False

    return end


TaggedReader.dispatch.update({tag: _end_of(tag) for tag in STRUCTS + SCALARS})


def read(body: bytes) -> Any:
    """Return the value of a response; a fault is a pair of "fault" and its text."""
    import xml.parsers.expat

    reader = TaggedReader(use_builtin_types=True)
    parser = xml.parsers.expat.ParserCreate()
    parser.StartElementHandler = reader.start
    parser.EndElementHandler = reader.end
    parser.CharacterDataHandler = reader.data
    reader.xml(None, None)  # type: ignore[arg-type]
    parser.Parse(body, True)
    try:
        (value,) = reader.close()
    except xmlrpc.client.Fault as fault:
        return ["fault", fault.faultCode, fault.faultString]
    return value


def comparable(method: str, value: Any) -> Any:
    """Take out what differs from run to run: names and numbers of participants, and the order."""
    plain = _plain(value)
    if UNORDERED.match(method) and isinstance(plain, list) and plain[:1] != ["fault"]:
        return sorted(plain, key=repr)
    return plain


def _plain(value: Any) -> Any:
    if isinstance(value, str):
        for pattern, word in _VOLATILE:
            value = pattern.sub(word, value)
        return value
    if isinstance(value, bytes):
        return {"base64": value.hex()}
    if isinstance(value, dict):
        return {
            name: "GID" if name == "endpoint_gid" and _is_gid(member) else _plain(member)
            for name, member in value.items()
        }
    if isinstance(value, list | tuple):
        return [_plain(element) for element in value]
    return value


def _is_gid(value: Any) -> bool:
    return isinstance(value, list) and len(value) == 16 and all(type(byte) is int for byte in value)
