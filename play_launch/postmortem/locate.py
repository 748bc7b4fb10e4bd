"""Findings with the source lines of their backtraces."""

from __future__ import annotations

from typing import TYPE_CHECKING

from msgspec.structs import replace

from play_launch.postmortem.elf_files import DEBUG_FOLDERS
from play_launch.postmortem.frames import FAULTS, blamed
from play_launch.postmortem.source_lines import Backtrace, source_lines

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from play_launch.postmortem.findings import Finding
    from play_launch.postmortem.frames import Frame
    from play_launch.postmortem.source_lines import SourceLine, SourceLines


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
