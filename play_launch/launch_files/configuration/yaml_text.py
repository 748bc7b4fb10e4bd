"""Writes plain values as YAML that our own reader reads back as they were."""

from __future__ import annotations

import base64
import math
import re
from typing import TYPE_CHECKING, Any, Final

from play_launch.config.model import ParameterType, ParameterValue

if TYPE_CHECKING:
    from collections.abc import Iterator

_PLAIN: Final = re.compile(r"(?:--?[A-Za-z]|[A-Za-z_/])[A-Za-z0-9_./-]*", re.ASCII)
_OTHER_MEANING: Final = frozenset("null true false yes no on off y n".split())  # noqa: SIM905
_SUBSTITUTION: Final = re.compile(r"\$(?=[{(])")
_ESCAPES: Final = {'"': '\\"', "\\": "\\\\", "\n": "\\n", "\t": "\\t", "\r": "\\r"}
_WIDEST: Final = 96
"""Characters of a list or mapping that stands on one line."""
_MOST_ON_A_LINE: Final = 3
"""Entries of a mapping that stands on one line."""
_CLASS: Final = re.compile(r"[A-Za-z_][A-Za-z0-9_]*(?:::[A-Za-z_][A-Za-z0-9_]*)+", re.ASCII)


class Commented(dict[str, Any]):
    """A mapping with a line before it that says where it comes from."""

    def __init__(self, values: dict[str, Any], comment: str) -> None:
        super().__init__(values)
        self.comment = comment


class Verbatim(str):
    """A text whose substitutions are meant, so that they are not escaped."""

    __slots__ = ()


def yaml_text(values: dict[str, Any]) -> str:
    """Return a mapping as YAML, in block style where it is long.

    Values are mappings, lists, texts, numbers, truth values, and parameters of ROS.
    """
    return "".join(f"{line}\n" for line in _mapping(values, ""))


def _mapping(values: dict[str, Any], indentation: str) -> Iterator[str]:
    for key, value in values.items():
        yield from _below(f"{indentation}{_text(key, is_key=True)}:", value, indentation)


def _below(begin: str, value: Any, indentation: str) -> Iterator[str]:
    short = value if isinstance(value, str) and _CLASS.fullmatch(value) else _flow(value)
    if short is not None and len(begin) + len(short) < _WIDEST:
        yield f"{begin} {short}"
    elif isinstance(value, dict):
        yield begin
        yield from _mapping(value, indentation + "  ")
    elif isinstance(value, list):
        yield begin
        for item in value:
            yield from _item(item, indentation + "  ")
    else:
        yield f"{begin} {_scalar(value)}"


def _item(item: Any, indentation: str) -> Iterator[str]:
    if not isinstance(item, dict) or not item or _is_short_override(item):
        yield from _below(f"{indentation}-", item, indentation)
        return
    if isinstance(item, Commented) and item.comment:
        yield f"{indentation}# {printable(item.comment)}"
    for number, line in enumerate(_mapping(item, indentation + "  ")):
        yield line if number else f"{indentation}- {line.lstrip()}"


def _is_short_override(item: dict[str, Any]) -> bool:
    """Whether it is a mapping of values among parameter files, on one line."""
    return not isinstance(item, Commented) and _flow_mapping(item) is not None


def _flow(value: Any) -> str | None:
    """Write a value on one line; None where it should be a block."""
    if isinstance(value, dict):
        return _flow_mapping(value)
    if isinstance(value, list):
        items = [_scalar(item) for item in value if not isinstance(item, dict | list)]
        return f"[{', '.join(items)}]" if len(items) == len(value) else None
    return _scalar(value)


def _flow_mapping(value: dict[str, Any]) -> str | None:
    if len(value) > _MOST_ON_A_LINE or any(
        isinstance(each, dict | list) for each in value.values()
    ):
        return None
    pairs = (f"{_text(key, is_key=True)}: {_scalar(each)}" for key, each in value.items())
    return f"{{{', '.join(pairs)}}}"


def _scalar(value: Any) -> str:
    if isinstance(value, ParameterValue):
        return _parameter(value)
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float):
        return _double(value)
    return _text(value if isinstance(value, Verbatim) else str(value))


def _parameter(parameter: ParameterValue) -> str:
    value = parameter.value
    if isinstance(value, bytes):
        if not value:
            return "!byte_array []"
        return f"!!binary {base64.b64encode(value).decode('ascii')}"
    if isinstance(value, tuple):
        tag = "" if value else f"!{ParameterType(parameter.type).name.lower()} "
        return f"{tag}[{', '.join(_scalar(item) for item in value)}]"
    return _scalar(value)


def _double(value: float) -> str:
    if math.isfinite(value):
        return repr(value)
    return ".nan" if math.isnan(value) else ".inf" if value > 0 else "-.inf"


def _text(text: str, *, is_key: bool = False) -> str:
    if not is_key and not isinstance(text, Verbatim):
        text = _SUBSTITUTION.sub("$$", text)
    if _PLAIN.fullmatch(text) and text.lower() not in _OTHER_MEANING:
        return text
    return '"' + "".join(_character(each) for each in text) + '"'


def _character(character: str) -> str:
    if character in _ESCAPES:
        return _ESCAPES[character]
    if character.isprintable():
        return character
    code = ord(character)
    if code < 0x100:
        return f"\\x{code:02x}"
    return f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}"


def printable(text: str) -> str:
    """Leave out what YAML permits in no comment."""
    return "".join(each for each in text if each.isprintable())
