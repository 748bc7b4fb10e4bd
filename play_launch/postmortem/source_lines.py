"""Source lines of a backtrace, looked up afterwards in the files of this machine.

The system's ``addr2line`` reads them: it follows separate debug files and inlining. A line is given
only when the file is the very build that crashed.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path
from typing import TYPE_CHECKING, Final

from msgspec import Struct
from msgspec.structs import replace

from play_launch.postmortem.elf_files import DEBUG_FOLDERS, file_with_lines, read_elf
from play_launch.postmortem.frames import FAULTS, blamed

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from play_launch.postmortem.findings import Finding
    from play_launch.postmortem.frames import Frame

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
    function: str = ""
    """In which function; empty where that is not known."""

    def __str__(self) -> str:
        return f"{self.file}:{self.line}"


class Backtrace(Struct, frozen=True):
    """What led to a failure."""

    frames: Sequence[Frame]
    """Innermost first."""
    modules: Sequence[Module]
    """The libraries and programs that they are in."""
    is_fault: bool
    """Whether the first frame is an instruction that failed; all others, and this one of an
    exception, are the addresses at which a call returns."""

    def addresses(self, module: Module) -> dict[int, int]:
        """Give what to look up in a module, by the number of the frame."""
        # What follows a call may belong to the next line, or to the next function.
        return {
            number: frame.offset - (number > 0 or not self.is_fault)
            for number, frame in enumerate(self.frames)
            if frame.library == module.name
        }


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
    backtraces: Sequence[Backtrace], debug_folders: tuple[Path, ...] = DEBUG_FOLDERS
) -> list[SourceLines]:
    """Look the lines of backtraces up; each library is read once, which may take a second or two.

    ``debug_folders`` are where debug files of packages are.
    """
    wanted: dict[Module, set[int]] = {}
    for trace in backtraces:
        for module in trace.modules:
            wanted.setdefault(module, set()).update(trace.addresses(module).values())
    found = {
        module: _lines_in(module, sorted(addresses), debug_folders)
        for module, addresses in wanted.items()
        if addresses
    }
    return [_lines_of(trace, found) for trace in backtraces]


def _lines_of(
    trace: Backtrace, found: Mapping[Module, Mapping[int, SourceLine | None] | str]
) -> SourceLines:
    lines: dict[int, SourceLine] = {}
    problems: dict[str, str] = {}
    named = {module.name for module in trace.modules}
    for frame in trace.frames:
        if frame.library and frame.library not in named:
            problems[frame.library] = f"the recording does not say which build {frame.library} was"
    for module in trace.modules:
        known = found.get(module, {})
        if isinstance(known, str):
            problems[module.name] = known
            continue
        for number, address in trace.addresses(module).items():
            if line := known.get(address):
                lines[number] = line
    return SourceLines(lines, problems)


def _lines_in(
    module: Module, addresses: Sequence[int], debug_folders: tuple[Path, ...]
) -> Mapping[int, SourceLine | None] | str:
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
    """Look the source lines of findings up, in the files of this machine."""
    chosen = [each for each in findings if blamed(each.frames) is not None]
    found = iter(source_lines(list(map(_backtrace, chosen)), debug_folders))
    return tuple(
        each if (number := blamed(each.frames)) is None else _with_lines(each, number, next(found))
        for each in findings
    )


def _backtrace(finding: Finding) -> Backtrace:
    signature = finding.signature
    is_fault = signature is not None and signature.what in FAULTS
    return Backtrace(finding.frames, finding.modules, is_fault)


def _with_lines(finding: Finding, number: int, found: SourceLines) -> Finding:
    """Add them; ``number`` is that of the frame to blame.

    Why the line of that is not known is said in the problems; others have none.
    """
    lines = tuple(found.lines.get(index) for index in range(len(finding.frames)))
    problem = found.problems.get(finding.frames[number].library)
    frames = tuple(map(_with_function, finding.frames, lines))
    return replace(
        finding,
        frames=frames,
        lines=lines,
        place=replace(finding.place, frame=frames[number], line=lines[number]),
        problems=(*finding.problems, f"no source line: {problem}") if problem else finding.problems,
    )


def _with_function(frame: Frame, line: SourceLine | None) -> Frame:
    """Name what the container had no time to look up."""
    if frame.function or line is None or not line.function:
        return frame
    number, _, where = frame.text.rpartition(" ")
    return replace(frame, text=f"{number} {line.function} ({where})", function=line.function)
