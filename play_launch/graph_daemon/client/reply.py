"""Reads the XML of an XML-RPC reply with expat alone.

``xmlrpc.client`` of the standard library would do, but importing it takes longer than all the rest
of a thin client: it brings http, email, gzip and datetime.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, TypeAlias
from xml.parsers import expat

if TYPE_CHECKING:
    from collections.abc import Callable

Value: TypeAlias = "bool | int | float | str | list[Value] | dict[str, Value] | None"

_DEEPEST: Final = 32
"""Nested arrays and structs; the deepest real answer has six."""
_BOOLEANS: Final = {"0": False, "1": True}


class ReplyFormatError(ValueError):
    """The text is no XML-RPC reply."""


class Fault(Exception):  # noqa: N818 - the protocol's own word
    """The daemon answered that the call failed there.

    Attributes:
        code: The number that the daemon gave, 1 in ros2cli.
        text: ``<class 'X'>:message`` of the exception in the daemon.
    """

    def __init__(self, code: int, text: str) -> None:
        super().__init__(text)
        self.code = code
        self.text = text


def read_reply(body: bytes) -> Value:
    """Return the one value of a method response.

    Raises ``Fault`` when the response is one, and ``ReplyFormatError`` when ``body`` is no method
    response, or holds a type that no answer about the graph's names has.
    """
    reader = _Reader()
    try:
        reader.parse(body)
        return reader.result()
    except expat.ExpatError as error:
        raise ReplyFormatError(f"no XML: {error}") from None
    except (IndexError, KeyError, ValueError, TypeError) as error:
        if isinstance(error, ReplyFormatError):
            raise
        raise ReplyFormatError(f"misplaced or malformed value ({error})") from None


class _Reader:
    """Keeps finished values on a stack; an array or struct takes those above its mark."""

    def __init__(self) -> None:
        self._values: list[Value] = []
        self._marks: list[int] = []
        self._text: list[str] = []
        self._untyped = False
        self._is_fault = False
        self._is_response = False

    def parse(self, body: bytes) -> None:
        parser = expat.ParserCreate()
        parser.buffer_text = True
        parser.StartElementHandler = self._start
        parser.EndElementHandler = self._end
        parser.CharacterDataHandler = self._text.append
        # A reply needs no declarations, and entities could grow without limit.
        parser.StartDoctypeDeclHandler = self._refuse_doctype
        parser.Parse(body, True)

    def result(self) -> Value:
        if not self._is_response or len(self._values) != 1 or self._marks:
            raise ReplyFormatError("no method response with one value")
        value = self._values[0]
        if not self._is_fault:
            return value
        if not isinstance(value, dict):
            raise ReplyFormatError("a fault without its two members")
        code, text = value["faultCode"], value["faultString"]
        if not isinstance(code, int) or not isinstance(text, str):
            raise ReplyFormatError("a fault whose members have wrong types")
        raise Fault(code, text)

    def _start(self, tag: str, _attributes: dict[str, str]) -> None:
        self._text.clear()
        if tag == "value":
            self._untyped = True
            return
        if tag in {"array", "struct"}:
            if len(self._marks) == _DEEPEST:
                raise ReplyFormatError(f"values nested deeper than {_DEEPEST}")
            self._marks.append(len(self._values))
        elif tag not in _SCALARS and tag not in _FRAME:
            raise ReplyFormatError(f"a value of the unknown type {tag[:80]!r}")
        self._untyped = False

    def _end(self, tag: str) -> None:
        text = "".join(self._text)
        self._text.clear()
        if convert := _SCALARS.get(tag):
            self._values.append(convert(text))
        elif tag == "value":
            if self._untyped:
                self._values.append(text)
        elif tag == "name":
            self._values.append(text)
        elif tag == "array":
            mark = self._marks.pop()
            self._values[mark:] = [self._values[mark:]]
        elif tag == "struct":
            self._values.append(self._struct(self._marks.pop()))
        elif tag == "fault":
            self._is_fault = True
        elif tag == "methodResponse":
            self._is_response = True
        self._untyped = False

    def _struct(self, mark: int) -> dict[str, Value]:
        members: dict[str, Value] = {}
        taken = self._values[mark:]
        del self._values[mark:]
        for name, value in zip(taken[::2], taken[1::2], strict=True):
            if not isinstance(name, str):
                raise ReplyFormatError("a struct's member without a name")
            members[name] = value
        return members

    def _refuse_doctype(self, *_arguments: object) -> None:
        raise ReplyFormatError("a document type declaration")


def _nil(_text: str) -> None:
    return None


_SCALARS: Final[dict[str, Callable[[str], Value]]] = {
    "boolean": lambda text: _BOOLEANS[text.strip()],
    "double": float,
    "i4": int,
    "i8": int,
    "int": int,
    "nil": _nil,
    "string": str,
}
_FRAME: Final = frozenset({"methodResponse", "params", "param", "fault", "data", "member", "name"})
