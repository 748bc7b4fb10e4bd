"""Parameters as rcl reads them: its own parser, by ctypes.

The structures are those of `rcl_yaml_param_parser/types.h` of ROS 2 Jazzy. A file that rcl refuses
ends the node that gets it, so its error is reported in rcl's words.
"""

from __future__ import annotations

import array
import ctypes
import functools
from typing import TYPE_CHECKING, Any, Final

from play_launch.config.model import (
    FOR_ALL,
    ParameterConfig,
    ParameterSection,
    ParameterType,
    ParameterValue,
)

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

_PARSER: Final = "librcl_yaml_param_parser.so"
_UTILITIES: Final = "librcutils.so"


class RclParametersError(Exception):
    """The parser of rcl refuses something; the text is its own."""


class _ErrorString(ctypes.Structure):
    _fields_ = (("str", ctypes.c_char * 1024),)


class _Allocator(ctypes.Structure):
    _fields_ = tuple(
        (name, ctypes.c_void_p)
        for name in ("allocate", "deallocate", "reallocate", "zero_allocate", "state")
    )


class _Array(ctypes.Structure):
    _fields_ = (("values", ctypes.c_void_p), ("size", ctypes.c_size_t))


class _StringArray(ctypes.Structure):
    _fields_ = (("size", ctypes.c_size_t), ("data", ctypes.POINTER(ctypes.c_char_p)))


_SCALARS: Final[dict[ParameterType, type[Any]]] = {
    ParameterType.BOOL: ctypes.c_bool,
    ParameterType.INTEGER: ctypes.c_int64,
    ParameterType.DOUBLE: ctypes.c_double,
}
_ARRAYS: Final[dict[ParameterType, type[Any]]] = {
    ParameterType.BYTE_ARRAY: ctypes.c_uint8,
    ParameterType.BOOL_ARRAY: ctypes.c_bool,
    ParameterType.INTEGER_ARRAY: ctypes.c_int64,
    ParameterType.DOUBLE_ARRAY: ctypes.c_double,
}


class _Variant(ctypes.Structure):
    # One pointer for each type, in the order of their numbers; all but one are null.
    _fields_ = tuple(
        (kind.name.lower(), ctypes.c_char_p if kind is ParameterType.STRING else ctypes.c_void_p)
        for kind in ParameterType
    )


class _NodeParameters(ctypes.Structure):
    _fields_ = (
        ("names", ctypes.POINTER(ctypes.c_char_p)),
        ("values", ctypes.POINTER(_Variant)),
        ("count", ctypes.c_size_t),
        ("capacity", ctypes.c_size_t),
    )


class _Parameters(ctypes.Structure):
    _fields_ = (
        ("node_names", ctypes.POINTER(ctypes.c_char_p)),
        ("nodes", ctypes.POINTER(_NodeParameters)),
        ("count", ctypes.c_size_t),
        ("capacity", ctypes.c_size_t),
        ("allocator", _Allocator),
    )


@functools.cache
def _libraries() -> tuple[ctypes.CDLL, ctypes.CDLL]:
    """Return the utilities and the parser of rcl, with the types of what is called in them."""
    utilities, parser = ctypes.CDLL(_UTILITIES), ctypes.CDLL(_PARSER)
    utilities.rcutils_get_default_allocator.restype = _Allocator
    utilities.rcutils_get_error_string.restype = _ErrorString
    parser.rcl_yaml_node_struct_init.argtypes = [_Allocator]
    parser.rcl_yaml_node_struct_init.restype = ctypes.POINTER(_Parameters)
    parser.rcl_yaml_node_struct_fini.argtypes = [ctypes.POINTER(_Parameters)]
    parser.rcl_parse_yaml_file.argtypes = [ctypes.c_char_p, ctypes.POINTER(_Parameters)]
    parser.rcl_parse_yaml_file.restype = ctypes.c_bool
    texts = [ctypes.c_char_p] * 3
    parser.rcl_parse_yaml_value.argtypes = [*texts, ctypes.POINTER(_Parameters)]
    parser.rcl_parse_yaml_value.restype = ctypes.c_bool
    return utilities, parser


class RclParameters:
    """The parameters that a process gets: sections in the order in which rcl saw them first.

    Raises OSError where the libraries of rcl are not to be found.
    """

    def __init__(self) -> None:
        self._utilities, self._parser = _libraries()
        self._held = self._parser.rcl_yaml_node_struct_init(
            self._utilities.rcutils_get_default_allocator()
        )
        if not self._held:
            raise MemoryError

    def close(self) -> None:
        """Give the memory back."""
        self._parser.rcl_yaml_node_struct_fini(self._held)

    def add_file(self, path: Path | str) -> None:
        """Read a file, as `--params-file` does; raises `RclParametersError`."""
        if not self._parser.rcl_parse_yaml_file(str(path).encode(), self._held):
            raise RclParametersError(self._error())

    def add_rule(self, rule: str) -> None:
        """Read `name:=value` or `node:name:=value`, as `-p` does; raises `RclParametersError`."""
        name, separator, value = rule.partition(":=")
        node, colon, own = name.rpartition(":")
        if not separator or not own:
            raise RclParametersError(f"{rule!r} is not of the form name:=value")
        texts = (text.encode() for text in (node if colon else FOR_ALL, own, value))
        if not self._parser.rcl_parse_yaml_value(*texts, self._held):
            raise RclParametersError(self._error())

    def sections(self) -> Iterator[ParameterSection]:
        """Return what was read; a name without a slash gets one, as in rclcpp."""
        held = self._held.contents
        for number in range(held.count):
            pattern = held.node_names[number].decode(errors="replace")
            node = held.nodes[number]
            parameters = tuple(_parameters(node))
            yield ParameterSection(
                pattern if pattern.startswith("/") else f"/{pattern}", parameters
            )

    def _error(self) -> str:
        text: bytes = self._utilities.rcutils_get_error_string().str
        self._utilities.rcutils_reset_error()
        # rcl puts its own source file and line behind it.
        return text.decode(errors="replace").split(", at ", 1)[0].strip()


def _parameters(node: _NodeParameters) -> Iterator[ParameterConfig]:
    for number in range(node.count):
        found = _value(node.values[number])
        if found is not None:
            yield ParameterConfig(node.names[number].decode(errors="replace"), found)


def _value(variant: _Variant) -> ParameterValue | None:
    """Return the value; None where the file gives none, such as for an empty list."""
    for kind in ParameterType:
        pointer = getattr(variant, kind.name.lower())
        if pointer is None:
            continue
        if kind is ParameterType.STRING:
            return ParameterValue(kind, pointer.decode(errors="replace"))
        if kind in _SCALARS:
            return ParameterValue(kind, _SCALARS[kind].from_address(pointer).value)
        if kind is ParameterType.STRING_ARRAY:
            texts = _StringArray.from_address(pointer)
            items = [texts.data[at] or b"" for at in range(texts.size)]
            return ParameterValue(kind, tuple(item.decode(errors="replace") for item in items))
        array = _Array.from_address(pointer)
        values = (_ARRAYS[kind] * array.size).from_address(array.values) if array.size else ()
        if kind is ParameterType.BYTE_ARRAY:
            return ParameterValue(kind, bytes(values))
        return ParameterValue(kind, tuple(values))
    return None


def parameter_of(given: Any) -> ParameterConfig | None:
    """Return what a `rclpy.Parameter` holds; None where it is not set."""
    value, number = given.value, given.type_.value
    if not number:
        return None
    kind = ParameterType(number)
    if kind is ParameterType.BYTE_ARRAY:
        value = b"".join(value)
    elif isinstance(value, list | tuple | array.array):
        value = tuple(value)
    return ParameterConfig(given.name, ParameterValue(kind, value))
