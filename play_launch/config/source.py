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

MCAP_MESSAGE = "is an MCAP recording; give the YAML file that describes the system"
"""About a recording without a configuration, or whose name does not end in .mcap."""
_LINE_END = re.compile(r"\r\n|\r|\n")
# What YAML calls not printable, and the byte order mark, which belongs at the very beginning.
_NOT_YAML = re.compile(
    "[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x84\x86-\x9f\ud800-\udfff\ufeff\ufffe\uffff]"
)


class Refused(Struct, frozen=True):
    """Reason why a file cannot be used; `inside` is whether its content is the reason."""

    location: Location
    message: str
    inside: bool = False


def read_bytes(path: Path, largest: int = LARGEST_FILE) -> bytes | Refused:
    """Read the regular file at `path`, at most `largest` bytes; never waits for a writer."""
    message = f"is larger than {largest // (1024 * 1024)} MiB, the limit for one file; "
    message += "move long parameter lists into parameter files"
    try:
        with open(path, "rb", opener=_open) as file:
            if stat.S_ISREG(os.fstat(file.fileno()).st_mode):
                content = file.read(largest + 1)
                if len(content) <= largest:
                    return content
            else:
                message = "is a pipe or a device; write what comes from it to a file first"
    except IsADirectoryError:
        message = "is a directory"
    except FileNotFoundError:
        is_link = os.path.islink(path)  # noqa: PTH114 - never raises
        message = "is a symbolic link to a file that does not exist" if is_link else "no such file"
    except OSError as error:
        message = f"cannot be read: {(error.strerror or str(error)).lower()}"
    except ValueError as error:
        message = f"is not a path: {error}"
    return Refused(Location(str(path), 1, 1), message)


def _open(path: str, flags: int) -> int:
    return os.open(path, flags | os.O_NONBLOCK | os.O_NOCTTY)


def path_from(at: Cursor, path: str) -> Path:
    """Return the path that stands there; a relative one starts at the folder of its file."""
    return Path(at.node.location.file).parent / os.path.expanduser(path)  # noqa: PTH111 - never raises


def decode(content: bytes, file: str) -> str | Refused:
    """Turn the bytes of `file` into text that a YAML parser accepts."""
    if content.startswith(b"\x89MCAP0\r\n"):
        return Refused(Location(file, 1, 1), MCAP_MESSAGE, inside=True)
    content = content.removeprefix(b"\xef\xbb\xbf")
    try:
        text = content.decode("utf-8")
    except UnicodeDecodeError as error:
        text = content[: error.start].decode("utf-8")
        message = f"byte 0x{content[error.start]:02x} is not UTF-8; save the file as UTF-8"
        return Refused(_location_after(text, file), message, inside=True)
    found = _NOT_YAML.search(text)
    if found is None:
        return text
    message = (
        f"the control character U+{ord(found[0]):04X} cannot stand in YAML; remove it, or write it "
        'as an escape in double quotes, such as "\\x1b"'
    )
    if found[0] == "\x00":
        message = "a NUL byte; is this UTF-16 or a binary file? Save it as UTF-8"
    return Refused(_location_after(text[: found.start()], file), message, inside=True)


def _location_after(text: str, file: str) -> Location:
    lines = _LINE_END.split(text)
    return Location(file, len(lines), len(lines[-1]) + 1)
