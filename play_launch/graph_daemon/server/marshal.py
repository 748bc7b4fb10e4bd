"""XML-RPC as ros2cli's daemon writes it.

Plain values are written exactly as ``xmlrpc.client`` writes them. ROS values that XML-RPC does not
know are elements named like their Python class (``<rclpy.qos.QoSProfile>``), which ros2cli's
clients turn back into objects. Here they are `Tagged` and `TaggedStruct`, so that this module needs
no ROS.
"""

from __future__ import annotations

import base64
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Final
from xml.parsers import expat
from xmlrpc.client import MAXINT, MININT, Binary, Fault, Unmarshaller, escape

_HEAD: Final = "<?xml version='1.0'?>\n<methodResponse>\n"
_TAIL: Final = "</methodResponse>\n"
_BASE64_LINE: Final = 57
"""Bytes on a line of base64; 57 give the 76 characters of RFC 2045."""
_NOT_XML: Final = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\ud800-\udfff\ufffe\uffff]")
"""A participant may put any of these into a name; a parser would refuse the whole answer then."""
FAULT_CODE: Final = 1
"""ros2cli's only fault code."""


_DURATION: Final = "rclpy.duration.Duration"
_STRUCTS: Final = frozenset(
    {
        "rclpy.qos.QoSProfile",
        "rclpy.topic_endpoint_info.TopicEndpointInfo",
        "rclpy.type_hash.TypeHash",
    }
)
_ENUMERATIONS: Final = frozenset(
    {
        "rclpy.qos.HistoryPolicy",
        "rclpy.qos.ReliabilityPolicy",
        "rclpy.qos.DurabilityPolicy",
        "rclpy.qos.LivelinessPolicy",
        "rclpy.topic_endpoint_info.TopicEndpointTypeEnum",
    }
)


@dataclass(frozen=True, slots=True)
class Tagged:
    """A scalar in an element of its own: an enumeration's number, nanoseconds of a duration."""

    tag: str
    text: str


@dataclass(frozen=True, slots=True)
class TaggedStruct:
    """Members in a struct inside an element of its own."""

    tag: str
    members: Mapping[str, object]


class DocumentTypeError(ValueError):
    """A request with a document type, whose entities could grow without bound."""

    def __init__(self) -> None:
        super().__init__("a document type is not accepted")


def parse_call(body: bytes) -> tuple[str | None, tuple[object, ...]]:
    """Return method and arguments of a request; the method is None where it names none.

    Raises what ``xmlrpc.client.loads`` raises (``ExpatError``, ``ResponseError``, ``Fault``,
    ``ValueError``…), and ``DocumentTypeError``.
    """
    target = Unmarshaller()
    parser = expat.ParserCreate(None, None)
    parser.StartElementHandler = target.start
    parser.EndElementHandler = target.end
    parser.CharacterDataHandler = target.data
    parser.StartDoctypeDeclHandler = _refuse_document_type
    target.xml(None, None)  # type: ignore[arg-type] # means: text comes decoded
    # Two steps, as `loads` does it, so that errors name the same place.
    parser.Parse(body, False)
    parser.Parse(b"", True)
    arguments = target.close()
    return target.getmethodname(), tuple(arguments)


def to_wire(value: object) -> object:
    """Return ``value`` with every known object of rclpy replaced; others stay as they are.

    An object says by its class what it is. That also fits Humble, whose classes have fewer members.
    """
    if isinstance(value, str | bytes):
        return value
    if isinstance(value, Sequence):
        return [to_wire(element) for element in value]
    if isinstance(value, Mapping):
        return {name: to_wire(member) for name, member in value.items()}
    kind = type(value)
    tag = f"{kind.__module__}.{kind.__name__}"
    if tag == _DURATION:
        return Tagged(tag, str(value.nanoseconds))  # type: ignore[attr-defined]
    if isinstance(value, Enum) and tag in _ENUMERATIONS:
        return Tagged(tag, str(value.value))
    if tag in _STRUCTS:
        # The slots give order and names of the members; their properties give the values.
        names = [slot.lstrip("_") for slot in kind.__slots__]  # type: ignore[attr-defined]
        return TaggedStruct(tag, {name: to_wire(getattr(value, name)) for name in names})
    return value


def dump_response(value: object) -> bytes:
    """Write the answer of a method.

    Raises ``TypeError`` for what cannot be written, ``OverflowError`` for an integer of more than
    32 bits.
    """
    parts = [_HEAD, "<params>\n<param>\n"]
    _write(value, parts)
    parts += ("</param>\n</params>\n", _TAIL)
    return _encode(parts)


def dump_fault(error: BaseException) -> bytes:
    """Write an exception as ros2cli's daemon does; a ``Fault`` keeps its code and text."""
    if isinstance(error, Fault):
        members = {"faultCode": error.faultCode, "faultString": error.faultString}
    else:
        members = {"faultCode": FAULT_CODE, "faultString": f"{type(error)}:{error}"}
    parts = [_HEAD, "<fault>\n"]
    _write_struct(members, parts)
    parts += ("</fault>\n", _TAIL)
    return _encode(parts)


def _encode(parts: list[str]) -> bytes:
    return "".join(parts).encode("utf-8", "xmlcharrefreplace")


def _write(value: object, parts: list[str]) -> None:
    # The frequent ones first: answers are mostly names.
    kind = type(value)
    if isinstance(value, str):
        parts.append(f"<value><string>{_text(value)}</string></value>\n")
    elif kind is list or kind is tuple:
        parts.append("<value><array><data>\n")
        for element in value:  # type: ignore[attr-defined]
            _write(element, parts)
        parts.append("</data></array></value>\n")
    elif kind is int:
        if not MININT <= value <= MAXINT:  # type: ignore[operator]
            raise OverflowError("int exceeds XML-RPC limits")
        parts.append(f"<value><int>{value}</int></value>\n")
    elif isinstance(value, Tagged):
        parts.append(f"<value><{value.tag}>{value.text}</{value.tag}></value>")
    elif isinstance(value, TaggedStruct):
        parts.append(f"<value><{value.tag}>")
        _write_struct(value.members, parts)
        parts.append(f"</{value.tag}></value>")
    else:
        _write_rare(value, parts)


def _text(value: str) -> str:
    return escape(value if value.isprintable() else _NOT_XML.sub("\ufffd", value))


def _write_rare(value: object, parts: list[str]) -> None:
    if value is None:
        parts.append("<value><nil/></value>")
    elif isinstance(value, bool):
        parts.append(f"<value><boolean>{int(value)}</boolean></value>\n")
    elif isinstance(value, float):
        parts.append(f"<value><double>{value!r}</double></value>\n")
    elif isinstance(value, dict):
        _write_struct(value, parts)
    elif isinstance(value, bytes | bytearray):
        _write_base64(bytes(value), parts)
    elif isinstance(value, Binary):
        _write_base64(value.data, parts)
    else:
        raise TypeError(f"cannot marshal {type(value)} objects")


def _write_struct(members: Mapping[str, object], parts: list[str]) -> None:
    parts.append("<value><struct>\n")
    for name, value in members.items():
        if not isinstance(name, str):
            raise TypeError("dictionary key must be string")
        parts.append(f"<member>\n<name>{_text(name)}</name>\n")
        _write(value, parts)
        parts.append("</member>\n")
    parts.append("</struct></value>\n")


def _write_base64(value: bytes, parts: list[str]) -> None:
    parts.append("<value><base64>\n")
    for start in range(0, len(value), _BASE64_LINE):
        line = base64.b64encode(value[start : start + _BASE64_LINE]).decode("ascii")
        parts.append(f"{line}\n")
    parts.append("</base64></value>\n")


def _refuse_document_type(*_: object) -> None:
    raise DocumentTypeError
