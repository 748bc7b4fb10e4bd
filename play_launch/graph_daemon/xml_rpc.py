"""XML-RPC as ros2cli's daemon writes it, by the standard library's marshaller.

ROS values that XML-RPC does not know are elements named like their Python class
(``<rclpy.qos.QoSProfile>``), which ros2cli's clients turn back into objects.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any, ClassVar, Final
from xml.parsers import expat
from xmlrpc.client import Fault, Marshaller, Unmarshaller, escape

if TYPE_CHECKING:
    from collections.abc import Callable

FAULT_CODE: Final = 1
"""ros2cli's only fault code."""
_NOT_XML: Final = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\ud800-\udfff\ufffe\uffff]")
"""Characters that a name in the graph may have and an XML parser refuses."""


class _Writer(Marshaller):
    dispatch: ClassVar[dict[Any, Any]] = dict(Marshaller.dispatch)  # type: ignore[misc]

    def dump_text(self, value: str, write: Callable[[str], object]) -> None:
        text = value if value.isprintable() else _NOT_XML.sub("\ufffd", value)
        write(f"<value><string>{escape(text)}</string></value>\n")

    dispatch[str] = dump_text


def register_scalar(kind: type, convert: Callable[[Any], int]) -> None:
    """Write values of ``kind`` as a number in an element of their own."""
    tag = f"{kind.__module__}.{kind.__name__}"

    def dump(_: _Writer, value: object, write: Callable[[str], object]) -> None:
        write(f"<value><{tag}>{convert(value)}</{tag}></value>")

    _Writer.dispatch[kind] = dump


def register_struct(kind: type) -> None:
    """Write values of ``kind`` as a struct of its slots; their properties give the values."""
    tag = f"{kind.__module__}.{kind.__name__}"
    names = [slot.lstrip("_") for slot in kind.__slots__]  # type: ignore[attr-defined]

    def dump(writer: _Writer, value: object, write: Callable[[str], object]) -> None:
        write(f"<value><{tag}>")
        writer.dump_struct({name: getattr(value, name) for name in names}, write)
        write(f"</{tag}></value>")

    _Writer.dispatch[kind] = dump


def parse_call(body: bytes) -> tuple[str | None, tuple[object, ...]]:
    """Return method and arguments of a request; the method is None where it names none.

    Raises what ``xmlrpc.client.loads`` raises, and ``ValueError`` for a document type, whose
    entities could grow without bound.
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


def dump_response(value: object) -> bytes:
    """Write the answer of a method; raises ``TypeError`` and ``OverflowError`` as xmlrpc does."""
    return _document((value,))


def dump_fault(error: BaseException) -> bytes:
    """Write an exception as ros2cli's daemon does; a ``Fault`` keeps its code and text."""
    is_fault = isinstance(error, Fault)
    return _document(error if is_fault else Fault(FAULT_CODE, f"{type(error)}:{error}"))


def _document(values: Any) -> bytes:
    text = _Writer(allow_none=True).dumps(values)
    document = f"<?xml version='1.0'?>\n<methodResponse>\n{text}</methodResponse>\n"
    return document.encode("utf-8", "xmlcharrefreplace")


def _refuse_document_type(*_: object) -> None:
    raise ValueError("a document type is not accepted")
