"""Bytes of a file, and the text in them: the only input of this package."""

from __future__ import annotations

import os
import re
import stat
from pathlib import Path
from typing import TYPE_CHECKING

from msgspec import Struct

from play_launch.config.problems import Location

if TYPE_CHECKING:
    from play_launch.config.tree import Cursor

LARGEST_FILE = 4 * 1024 * 1024
"""Bytes; keeps reading under a few seconds and is far more than any hand-written system."""

_BYTE_ORDER_MARK = b"\xef\xbb\xbf"
_MCAP = b"\x89MCAP0\r\n"
MCAP_MESSAGE = "is an MCAP recording; give the YAML file that describes the system"
"""About a recording that holds no configuration, or whose name does not say that it is one."""
_LINE_END = re.compile(r"\r\n|\r|\n")
# What YAML calls not printable, and the byte order mark, which belongs at the very beginning.
_NOT_YAML = re.compile(
    "[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x84\x86-\x9f\ud800-\udfff\ufeff\ufffe\uffff]"
)


class Refused(Struct, frozen=True):
    """Why a file is of no use, and where; `inside` is whether its content is to blame."""

    location: Location
    message: str
    inside: bool = False


def read_bytes(path: Path, largest: int = LARGEST_FILE) -> bytes | Refused:
    """Read the regular file at `path`, at most `largest` bytes; never waits for a writer."""
    start = Location(str(path), 1, 1)
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC | os.O_NOCTTY)
    except (OSError, ValueError) as error:
        return Refused(start, _why_not_opened(path, error))
    try:
        mode = os.fstat(descriptor).st_mode
        if not stat.S_ISREG(mode):
            return Refused(
                start, f"is {'a directory' if stat.S_ISDIR(mode) else 'no regular file'}"
            )
        with open(descriptor, "rb", closefd=False) as file:
            content = file.read(largest + 1)
    except OSError as error:
        return Refused(start, f"cannot be read: {error.strerror}")
    finally:
        os.close(descriptor)
    if len(content) > largest:
        return Refused(
            start,
            f"is larger than {largest // (1024 * 1024)} MiB, the limit for one file; "
            "move long parameter lists into parameter files",
        )
    return content


def path_from(at: Cursor, path: str) -> Path:
    """Return the path that stands there; a relative one starts at the folder of its file."""
    return Path(at.node.location.file).parent / os.path.expanduser(path)  # noqa: PTH111 - never raises


def decode(content: bytes, file: str) -> str | Refused:
    """Turn the bytes of `file` into text that a YAML parser takes without complaint."""
    if content.startswith(_MCAP):
        return Refused(Location(file, 1, 1), MCAP_MESSAGE, inside=True)
    content = content.removeprefix(_BYTE_ORDER_MARK)
    try:
        text = content.decode("utf-8")
    except UnicodeDecodeError as error:
        before = content[: error.start].decode("utf-8")
        return Refused(
            location_after(before, file),
            f"byte 0x{content[error.start]:02x} is not UTF-8; save the file as UTF-8",
            inside=True,
        )
    found = _NOT_YAML.search(text)
    if found is not None:
        location = location_after(text[: found.start()], file)
        if found.group() == "\x00":
            message = "a NUL byte; is this UTF-16 or a binary file? Save it as UTF-8"
            return Refused(location, message, inside=True)
        return Refused(
            location,
            f"the control character U+{ord(found.group()):04X} cannot stand in YAML; remove it, "
            'or write it as an escape in double quotes, such as "\\x1b"',
            inside=True,
        )
    return text


def location_after(text: str, file: str) -> Location:
    """Return the location of the character that follows `text` at the beginning of `file`."""
    line = 1
    line_start = 0
    for end in _LINE_END.finditer(text):
        line += 1
        line_start = end.end()
    return Location(file, line, len(text) - line_start + 1)


def _why_not_opened(path: Path, error: OSError | ValueError) -> str:
    if isinstance(error, FileNotFoundError):
        if os.path.islink(path):  # noqa: PTH114 - never raises
            return "is a symbolic link to a file that does not exist"
        return "no such file"
    if isinstance(error, PermissionError):
        return "cannot be read: permission denied"
    if isinstance(error, OSError):
        return f"cannot be opened: {error.strerror}"
    return f"is not a path: {error}"
