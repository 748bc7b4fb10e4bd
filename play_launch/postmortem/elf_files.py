"""Libraries and programs on this machine: which build a file is, and where its debug file is."""

from __future__ import annotations

import os
import struct
from pathlib import Path
from typing import IO, TYPE_CHECKING, Final, NamedTuple

from play_launch.recording.folder import open_regular

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

_MAGIC: Final = b"\x7fELF\x02\x01"
"""64 bits, little-endian: what ROS runs on."""
_HEADER: Final = struct.Struct("<16sHHIQQQIHHHHHH")
_PROGRAM_HEADER: Final = struct.Struct("<IIQQQQQQ")
_SECTION_HEADER: Final = struct.Struct("<IIQQQQIIQQ")
_NOTE_HEADER: Final = struct.Struct("<III")
_PT_NOTE: Final = 4
_NT_GNU_BUILD_ID: Final = 3
_LARGEST_TABLE: Final = 1 << 20
"""Bytes of a note or a table of section names; more is no ELF file of this world."""
DEBUG_FOLDERS: Final = (Path("/usr/lib/debug"),)


class ElfFile(NamedTuple):
    """What the headers of a file say."""

    path: Path
    build_id: str
    """In hexadecimal; empty where it was linked without one."""
    has_lines: bool
    """Whether it holds the source lines of its own code."""
    debug_link: str
    """File name of its debug file; empty without one."""


def read_elf(path: Path) -> ElfFile | None:
    """Read the headers of a file; None without one, or if it is something else."""
    try:
        # The path may be a recording's; what is there on this machine may be anything.
        with os.fdopen(open_regular(path, follow=True), "rb") as file:
            return _read(path, file)
    except (OSError, struct.error, ValueError):
        return None


def debug_files(
    elf: ElfFile, folders: tuple[Path, ...] = DEBUG_FOLDERS, environ: Mapping[str, str] = os.environ
) -> Iterator[Path]:
    """Give the places where the debug file of a stripped file may be, as gdb looks for it.

    By build id below the debug folders and in debuginfod's cache, by its ``.gnu_debuglink`` beside
    the file, in ``.debug`` there, and below the debug folders. Nothing is fetched.
    """
    if elf.build_id:
        name = Path(".build-id", elf.build_id[:2], f"{elf.build_id[2:]}.debug")
        yield from (folder / name for folder in folders)
        yield _debuginfod_cache(environ) / elf.build_id / "debuginfo"
    if elf.debug_link:
        folder = elf.path.resolve().parent
        yield folder / elf.debug_link
        yield folder / ".debug" / elf.debug_link
        yield from (debug / str(folder).lstrip("/") / elf.debug_link for debug in folders)


def file_with_lines(elf: ElfFile, folders: tuple[Path, ...] = DEBUG_FOLDERS) -> Path | None:
    """Find the file that holds the source lines of ``elf``: itself, or its debug file."""
    if elf.has_lines:
        return elf.path
    for path in debug_files(elf, folders):
        found = read_elf(path)
        # One without a build id cannot be distinguished from that of another build.
        if found is not None and found.has_lines and found.build_id == elf.build_id != "":
            return path
    return None


def _debuginfod_cache(environ: Mapping[str, str]) -> Path:
    if own := environ.get("DEBUGINFOD_CACHE_PATH"):
        return Path(own)
    cache = environ.get("XDG_CACHE_HOME") or "~/.cache"
    return Path(cache).expanduser() / "debuginfod_client"


def _read(path: Path, file: IO[bytes]) -> ElfFile | None:
    head = file.read(_HEADER.size)
    if not head.startswith(_MAGIC):
        return None
    (_, _, _, _, _, programs_at, sections_at, _, _, _, programs, _, sections, names) = (
        _HEADER.unpack(head)
    )
    build_id = ""
    for number in range(programs):
        kind, _, at, _, _, size, _, _ = _unpack(file, _PROGRAM_HEADER, programs_at, number)
        if kind == _PT_NOTE and not build_id:
            build_id = _build_id(_bytes(file, at, size))
    found = dict(_sections(file, sections_at, sections, names))
    link = ""
    if ".gnu_debuglink" in found:
        link = _bytes(file, *found[".gnu_debuglink"]).partition(b"\0")[0].decode("utf-8", "replace")
    has_lines = ".debug_line" in found or ".zdebug_line" in found
    return ElfFile(path, build_id, has_lines, link)


def _sections(
    file: IO[bytes], at: int, count: int, names: int
) -> Iterator[tuple[str, tuple[int, int]]]:
    """Give the name, and the place and size in the file, of each section that has a content."""
    if not count:
        return
    headers = [_unpack(file, _SECTION_HEADER, at, number) for number in range(count)]
    table = _bytes(file, headers[names][4], headers[names][5])
    for name, kind, _, _, offset, size, *_ in headers:
        if kind != 8:  # SHT_NOBITS: a debug file lists what it has not
            end = table.find(b"\0", name)
            yield table[name:end].decode("ascii", "replace"), (offset, size)


def _build_id(notes: bytes) -> str:
    at = 0
    while at + _NOTE_HEADER.size <= len(notes):
        name_size, size, kind = _NOTE_HEADER.unpack_from(notes, at)
        at += _NOTE_HEADER.size
        name = notes[at : at + name_size]
        at += (name_size + 3) & ~3
        if kind == _NT_GNU_BUILD_ID and name == b"GNU\0":
            return notes[at : at + size].hex()
        at += (size + 3) & ~3
    return ""


def _unpack(file: IO[bytes], form: struct.Struct, at: int, number: int) -> tuple[int, ...]:
    return form.unpack(_bytes(file, at + number * form.size, form.size))


def _bytes(file: IO[bytes], at: int, size: int) -> bytes:
    if size > _LARGEST_TABLE:
        raise ValueError(f"{size} bytes")
    file.seek(at)
    return file.read(size)
