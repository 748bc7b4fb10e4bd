"""What a YAML scalar means: the core schema of YAML 1.2.

PyYAML on its own reads YAML 1.1, where `on` is true, `010` is eight and `10:30` is 630. Here
those are a string, ten and a string.
"""

from __future__ import annotations

import base64
import binascii
import math
import re
from enum import Enum, auto
from typing import TypeAlias

from play_launch.config.problems import excerpt

_STANDARD = "tag:yaml.org,2002:"
_NULL = frozenset({"", "~", "null", "Null", "NULL"})
_BOOL = {
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
}
_DECIMAL = re.compile(r"[-+]?[0-9]+", re.ASCII)
_OCTAL = re.compile(r"0o[0-7]+", re.ASCII)
_HEXADECIMAL = re.compile(r"0x[0-9a-fA-F]+", re.ASCII)
_FLOAT = re.compile(r"[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?", re.ASCII)
_INFINITY = re.compile(r"([-+]?)\.(?:inf|Inf|INF)")
_NOT_A_NUMBER = frozenset({".nan", ".NaN", ".NAN"})


class ScalarKind(Enum):
    """The type of a scalar; INVALID where a problem has been reported already."""

    NULL = auto()
    BOOL = auto()
    INTEGER = auto()
    FLOAT = auto()
    STRING = auto()
    BINARY = auto()
    INVALID = auto()


ScalarValue: TypeAlias = bool | int | float | str | bytes | None


class ScalarRefusedError(ValueError):
    """The text does not go with its tag, or the tag is not supported."""


def resolve_scalar(text: str, tag: str | None, *, plain: bool) -> tuple[ScalarKind, ScalarValue]:
    """Return kind and value of the scalar `text`; `plain` is whether it stands without quotes.

    Raises ScalarRefusedError for unknown tags, and where text and tag do not go together.
    """
    if tag is None:
        return _resolve_plain(text) if plain else (ScalarKind.STRING, text)
    if tag == "!" or tag == _STANDARD + "str":
        return ScalarKind.STRING, text
    if tag == _STANDARD + "binary":
        return ScalarKind.BINARY, _decode_base64(text)
    expected = _KIND_OF_TAG.get(tag)
    if expected is None:
        raise ScalarRefusedError(unknown_tag(tag))
    kind, value = _resolve_plain(text)
    if kind is expected:
        return kind, value
    if expected is ScalarKind.FLOAT and isinstance(value, int) and kind is ScalarKind.INTEGER:
        return ScalarKind.FLOAT, _to_float(text)
    raise ScalarRefusedError(f"{excerpt(text)} does not go with the tag {shown_tag(tag)}")


_KIND_OF_TAG = {
    _STANDARD + "null": ScalarKind.NULL,
    _STANDARD + "bool": ScalarKind.BOOL,
    _STANDARD + "int": ScalarKind.INTEGER,
    _STANDARD + "float": ScalarKind.FLOAT,
}


def shown_tag(tag: str) -> str:
    """Write `tag` the way it is written in a file."""
    if tag.startswith(_STANDARD):
        return excerpt("!!" + tag.removeprefix(_STANDARD))[1:-1]
    return excerpt(tag)[1:-1]


def unknown_tag(tag: str) -> str:
    """Return the message for a tag that is not supported here."""
    return f"the tag {shown_tag(tag)} is not supported; write the value without it"


def _resolve_plain(text: str) -> tuple[ScalarKind, ScalarValue]:
    if text in _NULL:
        return ScalarKind.NULL, None
    if text in _BOOL:
        return ScalarKind.BOOL, _BOOL[text]
    if text[0] not in "+-.0123456789":
        return ScalarKind.STRING, text
    if _DECIMAL.fullmatch(text):
        return ScalarKind.INTEGER, _to_int(text, 10)
    if _OCTAL.fullmatch(text):
        return ScalarKind.INTEGER, _to_int(text, 8)
    if _HEXADECIMAL.fullmatch(text):
        return ScalarKind.INTEGER, _to_int(text, 16)
    if _FLOAT.fullmatch(text):
        return ScalarKind.FLOAT, _to_float(text)
    infinity = _INFINITY.fullmatch(text)
    if infinity is not None:
        return ScalarKind.FLOAT, -math.inf if infinity.group(1) == "-" else math.inf
    if text in _NOT_A_NUMBER:
        return ScalarKind.FLOAT, math.nan
    return ScalarKind.STRING, text


def _to_int(text: str, base: int) -> int:
    try:
        return int(text, 0 if base != 10 else 10)
    except ValueError:  # Python refuses more than 4,300 decimal digits
        raise ScalarRefusedError(f"a number of {len(text)} characters") from None


def _to_float(text: str) -> float:
    try:
        number = float(int(text, 0)) if text[:2] in {"0x", "0o"} else float(text)
    except OverflowError:
        number = math.inf
    if math.isinf(number):
        raise ScalarRefusedError(
            f"{excerpt(text)} is larger than any double; write .inf for infinity"
        )
    return number


def _decode_base64(text: str) -> bytes:
    try:
        return base64.b64decode("".join(text.split()), validate=True)
    except (binascii.Error, ValueError):
        raise ScalarRefusedError(
            f"{excerpt(text)} is not base64, which the tag !!binary needs"
        ) from None
