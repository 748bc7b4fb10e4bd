"""Source lines of a backtrace, looked up afterwards in the files of this machine.

The system's ``addr2line`` reads them; why it and no library is said in
docs/decisions/source-lines.md. A line is given only when the file is the very build that crashed.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path
from typing import TYPE_CHECKING, Final

from msgspec import Struct

from play_launch.history.elf_files import DEBUG_FOLDERS, file_with_lines, read_elf

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from play_launch.history.frames import Frame

_LIMIT: Final = 10.0
"""Seconds for one library; large ones take one or two."""


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

    def __str__(self) -> str:
        return f"{self.file}:{self.line}"


class SourceLines(Struct, frozen=True):
    """What was found for the frames of one backtrace."""

    lines: Mapping[int, SourceLine]
    """By the number of the frame."""
    problems: Mapping[str, str]
    """Why there are none, by the name of the module; the text names the fix."""


def module_of(text: str) -> Module | None:
    """Read ``name build-id path``, as containers write it beside a backtrace."""
    name, _, rest = text.partition(" ")
    build_id, _, path = rest.partition(" ")
    return Module(name, build_id.removeprefix("-"), path) if path else None


def source_lines(
    frames: Sequence[Frame],
    modules: Sequence[Module],
    *,
    is_fault: bool,
    debug_folders: tuple[Path, ...] = DEBUG_FOLDERS,
) -> SourceLines:
    """Look the lines of frames up.

    Args:
        frames: Of one backtrace, innermost first.
        modules: The libraries and programs that they are in.
        is_fault: Whether the first frame is an instruction that failed; all others, and this one
            of an exception, are the addresses at which a call returns.
        debug_folders: Where debug files of packages are.
    """
    lines: dict[int, SourceLine] = {}
    problems: dict[str, str] = {}
    named = {module.name for module in modules}
    for frame in frames:
        if frame.library and frame.library not in named:
            problems[frame.library] = f"the recording does not say which build {frame.library} was"
    for module in modules:
        wanted = [n for n, frame in enumerate(frames) if frame.library == module.name]
        if not wanted:
            continue
        file = _file_of(module, debug_folders)
        if isinstance(file, str):
            problems[module.name] = file
            continue
        # What follows a call may belong to the next line, or to the next function.
        at = [frames[n].offset - (n > 0 or not is_fault) for n in wanted]
        found = _addr2line(file, at)
        if isinstance(found, str):
            problems[module.name] = found
            continue
        lines |= {n: line for n, line in zip(wanted, found, strict=False) if line is not None}
    return SourceLines(lines, problems)


def _file_of(module: Module, debug_folders: tuple[Path, ...]) -> Path | str:
    """Find the file with the lines of a module, or say why there is none."""
    elf = read_elf(Path(module.path))
    if elf is None:
        return f"{module.path} is not on this machine"
    if not module.build_id or not elf.build_id:
        return f"{module.path} has no build id, so that nobody can say whether it is what crashed"
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
    command = [tool, "--exe", str(file), *(hex(each) for each in addresses)]
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, check=False, timeout=_LIMIT, env=environ
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        return f"addr2line {file}: {error}"
    if done.returncode != 0:
        return f"addr2line {file}: {done.stderr.strip() or f'exit status {done.returncode}'}"
    return [_line_of(text) for text in done.stdout.splitlines()]


def _line_of(text: str) -> SourceLine | None:
    """Read ``/src/talker.cpp:31 (discriminator 2)``; None for ``??:0``."""
    file, _, line = text.split(" (discriminator", maxsplit=1)[0].rpartition(":")
    if not (line.isdecimal() and int(line) and file):
        return None
    # Compilers write ``build/../src/talker.cpp``.
    return SourceLine(os.path.normpath(file), int(line))
