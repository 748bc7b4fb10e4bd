"""``rcl_interfaces/Log`` as bytes.

Output of nodes arrives in tens of thousands of lines a second. ``rclpy``'s serialiser takes
4 us a line with a reused message, this 1 us; the difference is a seventh of a core at 50,000
lines/s, taken from the event loop's thread as both share the interpreter lock. So lines have a
function of their own, all other messages a `Layout`. Tests hold the results equal to those of other
serialisers.
"""

from __future__ import annotations

from struct import Struct
from typing import Final

from play_launch.container.cdr.layout import split_time
from play_launch.container.cdr.text import text_bytes

_HEAD: Final = Struct("<4siIB3xI")
"""Encapsulation (little-endian CDR), stamp, level, and the length of the first string."""
_LENGTH: Final = Struct("<I")
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
    """Serialise one Log message; ``stamp_ns`` is in nanoseconds since the epoch.

    A stamp that ``builtin_interfaces/Time`` cannot hold becomes the nearest one it can.
    """
    seconds, nanoseconds = split_time(stamp_ns)
    a, b, c, d = text_bytes(name), text_bytes(message), text_bytes(file), text_bytes(function)
    size_a, size_b, size_c, size_d = len(a) + 1, len(b) + 1, len(c) + 1, len(d) + 1
    pack = _LENGTH.pack
    return b"".join(
        (
            _HEAD.pack(_ENCAPSULATION, seconds, nanoseconds, level, size_a),
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
