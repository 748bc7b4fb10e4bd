"""Source lines of a backtrace, looked up afterwards in the files of this machine.

The system's ``addr2line`` reads them: it follows separate debug files and inlining. A line is given
only when the file is the very build that crashed.
"""

from __future__ import annotations

import os
import shutil
import struct
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import IO, TYPE_CHECKING, Final, NamedTuple, TypeAlias

from msgspec import Struct
from msgspec.structs import replace

from play_launch.recording.folder import open_regular
from play_launch.supervisor.frames import FAULTS, blamed

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from play_launch.postmortem.findings import Finding
    from play_launch.supervisor.frames import StackFrame

_LIMIT: Final = 10.0
"""Seconds for one library; large ones take one or two."""
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


class Module(Struct, frozen=True):
    """A library or program that a backtrace leads through, as it was when it was loaded."""

    name: str
    build_id: str
    """In hexadecimal; empty where it has none."""
    path: str


class SourceLine(Struct, frozen=True):
    """Where a frame is in the source text."""

    file: str
    """As the compiler was given it."""
    line: int
    function: str = ""
    """In which function; empty where that is not known."""

    def __str__(self) -> str:
        return f"{self.file}:{self.line}"


_Lines: TypeAlias = Mapping[int, SourceLine | None]
"""By address."""


def module_of(text: str) -> Module | None:
    """Read ``name build-id path``, as containers write it beside a backtrace."""
    name, _, rest = text.partition(" ")
    build_id, _, path = rest.partition(" ")
    return Module(name, build_id.removeprefix("-"), path) if path else None


def _lines_in(
    module: Module, addresses: Sequence[int], debug_folders: tuple[Path, ...]
) -> _Lines | str:
    file = _file_of(module, debug_folders)
    if isinstance(file, str):
        return file
    found = _addr2line(file, addresses)
    return found if isinstance(found, str) else dict(zip(addresses, found, strict=False))


def _file_of(module: Module, debug_folders: tuple[Path, ...]) -> Path | str:
    """Find the file with the lines of a module, or give the reason why not."""
    elf = read_elf(Path(module.path))
    if elf is None:
        return f"{module.path} is not on this machine"
    if not module.build_id or not elf.build_id:
        return f"{module.path} has no build id, so it may not be the file that crashed"
    if elf.build_id != module.build_id:
        return (
            f"{module.path} is another build now ({elf.build_id[:12]}, "
            f"what crashed was {module.build_id[:12]})"
        )
    file = file_with_lines(elf, debug_folders)
    if file is None:
        return (
            f"{module.path} has no debug information and no debug file; "
            "build it with -g, or install its -dbgsym package"
        )
    return file


def _addr2line(file: Path, addresses: Sequence[int]) -> list[SourceLine | None] | str:
    tool = shutil.which("addr2line")
    if tool is None:
        return "addr2line is not installed; install binutils"
    # Without these, no server is asked.
    environ = {k: v for k, v in os.environ.items() if not k.startswith("DEBUGINFOD_")}
    try:
        done = subprocess.run(
            [tool, "--functions", "--demangle", "--exe", str(file)],
            input="".join(f"{each:#x}\n" for each in addresses),
            capture_output=True,
            text=True,
            check=False,
            timeout=_LIMIT,
            env=environ,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        return f"addr2line {file}: {error}"
    if done.returncode != 0:
        return f"addr2line {file}: {done.stderr.strip() or f'exit status {done.returncode}'}"
    said = done.stdout.splitlines()
    return [_line_of(text, name) for name, text in zip(said[::2], said[1::2], strict=False)]


def _line_of(text: str, function: str) -> SourceLine | None:
    """Read ``/src/talker.cpp:31 (discriminator 2)``; None for ``??:0``."""
    file, _, line = text.split(" (discriminator", maxsplit=1)[0].rpartition(":")
    if not (line.isdecimal() and int(line) and file):
        return None
    # Compilers write ``build/../src/talker.cpp``.
    return SourceLine(os.path.normpath(file), int(line), "" if function == "??" else function)


def located(
    findings: Sequence[Finding], debug_folders: tuple[Path, ...] = DEBUG_FOLDERS
) -> tuple[Finding, ...]:
    """Look the source lines of findings up, in the files of this machine.

    Each library is read once, which may take a second or two. ``debug_folders`` are where debug
    files of packages are.
    """
    wanted: dict[Module, set[int]] = {}
    for each in findings:
        for module in each.modules:
            wanted.setdefault(module, set()).update(_addresses(each, module).values())
    found = {
        module: _lines_in(module, sorted(addresses), debug_folders)
        for module, addresses in wanted.items()
        if addresses
    }
    return tuple(_with_lines(each, found) for each in findings)


def _addresses(finding: Finding, module: Module) -> dict[int, int]:
    """Give what to look up in a module, by the number of the frame."""
    # The first frame of a fault is the instruction that failed; all others are where a call
    # returns, which may belong to the next line, or to the next function.
    is_fault = finding.signature is not None and finding.signature.what in FAULTS
    return {
        number: frame.offset - (number > 0 or not is_fault)
        for number, frame in enumerate(finding.frames)
        if frame.library == module.name
    }


def _with_lines(finding: Finding, found: Mapping[Module, _Lines | str]) -> Finding:
    """Add the lines, and why that of the frame to blame is not known; others have no reason."""
    number = blamed(finding.frames)
    if number is None:
        return finding
    lines: list[SourceLine | None] = [None] * len(finding.frames)
    problem, library = "", finding.frames[number].library
    if library and all(module.name != library for module in finding.modules):
        problem = f"the recording does not say which build {library} was"
    for module in finding.modules:
        known = found.get(module, {})
        if isinstance(known, str):
            problem = known if module.name == library else problem
            continue
        for index, address in _addresses(finding, module).items():
            lines[index] = known.get(address) or lines[index]
    frames = tuple(map(_with_function, finding.frames, lines))
    return replace(
        finding,
        frames=frames,
        lines=tuple(lines),
        place=replace(finding.place, frame=frames[number], line=lines[number]),
        problems=(*finding.problems, f"no source line: {problem}") if problem else finding.problems,
    )


def _with_function(frame: StackFrame, line: SourceLine | None) -> StackFrame:
    """Name what the container had no time to look up."""
    if frame.function or line is None or not line.function:
        return frame
    number, _, where = frame.text.rpartition(" ")
    return replace(frame, text=f"{number} {line.function} ({where})", function=line.function)


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
