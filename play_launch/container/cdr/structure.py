"""What a message consists of, and by that how it is written and read.

rclpy does the same through its generated classes. It takes a tenth of a second to import them, and
0.4 ms to read the report of a crash when it has not read anything for a while: a third of the time
from the crash to its event. This needs neither, nor ROS. Tests hold both equal.
"""

from __future__ import annotations

from functools import cache, cached_property
from pathlib import Path
from struct import Struct, error, pack_into, unpack_from
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from collections.abc import Callable, Container, Mapping

    Writer = Callable[[bytearray, Any], None]
    Reader = Callable[[bytes, int], tuple[Any, int]]


def text_bytes(text: str) -> bytes:
    r"""Encode text for a CDR string, which can hold neither NUL nor half of a surrogate pair.

    Both are written as escapes (``\x00``, ``\udc80``), so that nothing disappears.
    """
    try:
        data = text.encode()
    except UnicodeEncodeError:
        data = text.encode("utf-8", "backslashreplace")
    return data.replace(b"\0", b"\\x00") if b"\0" in data else data


_ENCAPSULATION: Final = b"\x00\x01\x00\x00"
"""Little-endian CDR without options; positions are counted from its end."""
_LENGTH: Final = Struct("<I")
_TIME: Final = Struct("<iI")
_LATEST_SECOND: Final = 2**31 - 1
_NANOSECONDS: Final = 1_000_000_000


class CdrError(ValueError):
    """The bytes are not a message of this layout."""


_CODES: Final = {
    "bool": "?",
    "uint8": "B",
    "uint16": "H",
    "uint32": "I",
    "uint64": "Q",
    "int32": "i",
    "int64": "q",
    "float64": "d",
    "string": "s",
    "builtin_interfaces/Time": "t",
}
"""Types of definitions; a message has its own name without the package."""


DEFINITIONS: Final = Path(__file__).with_name("msg")
"""The folder of the ``.msg`` files of play_launch_msgs, which this package has of its own: what is
recorded is read where there is neither ROS nor our container."""


@cache
def definitions() -> dict[str, dict[str, str]]:
    """Read the fields of all messages of play_launch_msgs.

    All at once: while a session runs, another version may be installed.
    """
    found: dict[str, dict[str, str]] = {}
    for path in DEFINITIONS.glob("*.msg"):
        fields = found[path.stem] = {}
        for line in path.read_text(encoding="utf-8").splitlines():
            kind, _, field = line.partition("#")[0].strip().partition(" ")
            if field and "=" not in field:
                element = kind.removesuffix("[]")
                code = _CODES.get(element) or element.rpartition("/")[2]
                fields[field] = f"{code}[]" if kind != element else code
    return found


class Layout:
    """The fields of one message type, in their order.

    Types of fields are written as

    * numbers: letters of :mod:`struct` (``B`` uint8, ``?`` bool, ``q`` int64, ``d`` float64, ...);
    * ``s``: a string;
    * ``t``: a ``builtin_interfaces/Time``, in nanoseconds since the epoch (the nearest that fits);
    * ``y``: a sequence of octets, as bytes;
    * the name of another layout: that message, as a mapping;
    * any of these but ``t`` and ``y`` with ``[]`` behind it: a sequence, as a tuple.
    """

    def __init__(self, fields: str, **others: Layout) -> None:
        """Make it of ``name:type`` words and the layouts that they name.

        ``fields`` can also be the name of a message of play_launch_msgs.
        """
        self._fields = fields
        self._others = others

    @cached_property
    def types(self) -> dict[str, str]:
        """The type of each field."""
        if ":" in self._fields:
            return dict(word.split(":") for word in self._fields.split())
        return definitions()[self._fields]

    @cached_property
    def _writers(self) -> list[tuple[str, Writer, Any]]:
        return [
            (name, _writer(kind, self._others), _nothing(kind, self._others))
            for name, kind in self.types.items()
        ]

    @cached_property
    def _readers(self) -> list[tuple[str, Reader]]:
        return [(name, _reader(kind, self._others)) for name, kind in self.types.items()]

    @cached_property
    def _plain(self) -> _Plain | None:
        return _Plain(self.types) if _Plain.can_hold(self.types) else None

    def write(self, values: Mapping[str, Any]) -> bytes:
        r"""Serialise a message; what is not given is zero or empty.

        What a string cannot hold is written as an escape (``\x00``).

        Raises:
            struct.error: When a number does not fit into its field.
            KeyError: When there is no such field.
        """
        if self._plain is not None:
            return self._plain.write(values)
        data = bytearray()
        self._append(data, values)
        return _ENCAPSULATION + data

    def read(self, data: bytes) -> dict[str, Any]:
        """Read a message; bytes behind it do not matter, and what is no UTF-8 is replaced.

        Raises:
            CdrError: When it is not one.
        """
        if data[:2] != _ENCAPSULATION[:2]:
            raise CdrError("it does not begin as little-endian CDR")
        try:
            if self._plain is not None:
                return self._plain.read(data)
            values, _ = self._take(data[len(_ENCAPSULATION) :], 0)
        except (error, ValueError) as reason:
            raise CdrError(str(reason)) from reason
        return values

    def picker(self, *names: str) -> Callable[[bytes], tuple[Any, ...]]:
        """Give a function that reads only these numbers, in the order of the layout, or CdrError.

        Raises:
            ValueError: When these messages hold other things than numbers, or not these.
        """
        if not _Plain.can_hold(self.types) or not all(
            _is_number(self.types.get(name, "s")) for name in names
        ):
            raise ValueError(f"these are not numbers of a message of numbers: {', '.join(names)}")
        unpack_from = Struct(_plain_code(self.types, wanted=names)).unpack_from

        def pick(data: bytes) -> tuple[Any, ...]:
            if data[:2] != _ENCAPSULATION[:2]:
                raise CdrError("it does not begin as little-endian CDR")
            try:
                return unpack_from(data, len(_ENCAPSULATION))
            except error as reason:
                raise CdrError(str(reason)) from reason

        return pick

    def _append(self, data: bytearray, values: Mapping[str, Any]) -> None:
        if unknown := values.keys() - self.types.keys():
            raise KeyError(*unknown)
        for name, write, nothing in self._writers:
            write(data, values.get(name, nothing))

    def _take(self, data: bytes, at: int) -> tuple[dict[str, Any], int]:
        values: dict[str, Any] = {}
        for name, read in self._readers:
            values[name], at = read(data, at)
        return values, at


class _Plain:
    """A message of numbers and times alone: all of it is packed and unpacked at once.

    Samples are such, and a long recording has hundreds of thousands of them.
    """

    def __init__(self, types: Mapping[str, str]) -> None:
        self._defaults = dict.fromkeys(types, 0)
        self._times = tuple(name for name, kind in types.items() if kind == "t")
        self._slots: list[str] = []
        for name, kind in types.items():
            self._slots += (name, f"{name} in ns") if kind == "t" else (name,)
        self._packer = Struct(_plain_code(types, wanted=types))

    @staticmethod
    def can_hold(types: Mapping[str, str]) -> bool:
        return all(_is_number(kind) or kind == "t" for kind in types.values())

    def write(self, values: Mapping[str, Any]) -> bytes:
        given = {**self._defaults, **values}
        if len(given) > len(self._defaults):
            raise KeyError(*(given.keys() - self._defaults.keys()))
        for name in self._times:
            given[name], given[f"{name} in ns"] = split_time(given[name])
        return _ENCAPSULATION + self._packer.pack(*[given[name] for name in self._slots])

    def read(self, data: bytes) -> dict[str, Any]:
        numbers = self._packer.unpack_from(data, len(_ENCAPSULATION))
        values = dict(zip(self._slots, numbers, strict=True))
        for name in self._times:
            values[name] = values[name] * _NANOSECONDS + values.pop(f"{name} in ns")
        return values


def _plain_code(types: Mapping[str, str], *, wanted: Container[str]) -> str:
    """Give what `struct` takes for a message of numbers and times; the unwanted are passed over."""
    code, size = "<", 0
    for name, kind in types.items():
        number = _TIME if kind == "t" else Struct(f"<{kind}")
        padding = -size % (4 if kind == "t" else number.size)
        code += f"{padding}x{number.format[1:]}" if name in wanted else f"{padding + number.size}x"
        size += padding + number.size
    return code


def _writer(kind: str, others: Mapping[str, Layout]) -> Writer:
    if kind in others:
        return others[kind]._append  # noqa: SLF001 - it is one of ours
    if kind.endswith("[]"):
        element = kind.removesuffix("[]")
        return (
            _write_numbers(element) if _is_number(element) else _write_all(_writer(element, others))
        )
    return _WRITERS.get(kind) or _write_number(kind)


def _reader(kind: str, others: Mapping[str, Layout]) -> Reader:
    if kind in others:
        return others[kind]._take  # noqa: SLF001 - it is one of ours
    if kind.endswith("[]"):
        element = kind.removesuffix("[]")
        return (
            _read_numbers(element) if _is_number(element) else _read_all(_reader(element, others))
        )
    return _READERS.get(kind) or _read_number(kind)


def _nothing(kind: str, others: Mapping[str, Layout]) -> Any:
    if kind in others:
        return {}
    return () if kind.endswith("[]") else {"s": "", "y": b""}.get(kind, 0)


def _is_number(kind: str) -> bool:
    return len(kind) == 1 and kind not in "sty"


def _write_number(code: str) -> Writer:
    packer = Struct(f"<{code}")

    def write(data: bytearray, value: float) -> None:
        # Aligned to its own size.
        data += bytes(-len(data) % packer.size) + packer.pack(value)

    return write


def _write_text(data: bytearray, text: str) -> None:
    encoded = text_bytes(text)
    data += bytes(-len(data) % 4) + _LENGTH.pack(len(encoded) + 1) + encoded + b"\0"


def _write_time(data: bytearray, stamp_ns: int) -> None:
    data += bytes(-len(data) % 4) + _TIME.pack(*split_time(stamp_ns))


def _write_octets(data: bytearray, octets: bytes) -> None:
    data += bytes(-len(data) % 4) + _LENGTH.pack(len(octets)) + octets


def _write_numbers(code: str) -> Writer:
    size = Struct(f"<{code}").size

    def write(data: bytearray, values: tuple[float, ...]) -> None:
        data += bytes(-len(data) % 4) + _LENGTH.pack(len(values))
        if values:  # nothing has no place, and is not aligned
            data += bytes(-len(data) % size)
            at = len(data)
            data += bytes(size * len(values))
            pack_into(f"<{len(values)}{code}", data, at, *values)

    return write


def _write_all(write_one: Writer) -> Writer:
    def write(data: bytearray, values: tuple[Any, ...]) -> None:
        data += bytes(-len(data) % 4) + _LENGTH.pack(len(values))
        for value in values:
            write_one(data, value)

    return write


def _read_number(code: str) -> Reader:
    packer = Struct(f"<{code}")
    size, unpack = packer.size, packer.unpack_from

    def read(data: bytes, at: int) -> tuple[float, int]:
        at += -at % size
        return unpack(data, at)[0], at + size

    return read


def _read_text(data: bytes, at: int) -> tuple[str, int]:
    length, at = _read_length(data, at)
    if not length:
        return "", at
    end = at + length
    # As for any reader in C, it ends at its first NUL, and there has to be one.
    return data[at : data.index(0, at, end)].decode("utf-8", "replace"), end


def _read_time(data: bytes, at: int) -> tuple[int, int]:
    at += -at % 4
    seconds, nanoseconds = _TIME.unpack_from(data, at)
    return seconds * _NANOSECONDS + nanoseconds, at + _TIME.size


def _read_octets(data: bytes, at: int) -> tuple[bytes, int]:
    length, at = _read_length(data, at)
    return data[at : at + length], at + length


def _read_numbers(code: str) -> Reader:
    size = Struct(f"<{code}").size

    def read(data: bytes, at: int) -> tuple[tuple[float, ...], int]:
        length, at = _read_length(data, at)
        if not length:
            return (), at
        at += -at % size
        return unpack_from(f"<{length}{code}", data, at), at + size * length

    return read


def _read_all(read_one: Reader) -> Reader:
    def read(data: bytes, at: int) -> tuple[tuple[Any, ...], int]:
        length, at = _read_length(data, at)
        values = []
        for _ in range(length):
            value, at = read_one(data, at)
            values.append(value)
        return tuple(values), at

    return read


def _read_length(data: bytes, at: int) -> tuple[int, int]:
    at += -at % 4
    (length,) = _LENGTH.unpack_from(data, at)
    at += _LENGTH.size
    if length > len(data) - at:  # whatever it counts has a byte at least
        raise CdrError(f"{length} elements or bytes at {at}, of {len(data)}")
    return length, at


_WRITERS: Final[dict[str, Writer]] = {"s": _write_text, "t": _write_time, "y": _write_octets}
_READERS: Final[dict[str, Reader]] = {"s": _read_text, "t": _read_time, "y": _read_octets}


def split_time(stamp_ns: int) -> tuple[int, int]:
    """Seconds and nanoseconds of ``builtin_interfaces/Time``, or the nearest that it can hold."""
    seconds, nanoseconds = divmod(stamp_ns, _NANOSECONDS) if stamp_ns > 0 else (0, 0)
    if seconds > _LATEST_SECOND:
        return _LATEST_SECOND, _NANOSECONDS - 1
    return seconds, nanoseconds
