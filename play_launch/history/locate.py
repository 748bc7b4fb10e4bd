"""Findings with the source lines of their backtraces."""

from __future__ import annotations

from typing import TYPE_CHECKING

from msgspec.structs import replace

from play_launch.history.elf_files import DEBUG_FOLDERS
from play_launch.history.frames import FAULTS, blamed
from play_launch.history.source_lines import source_lines

if TYPE_CHECKING:
    from pathlib import Path

    from play_launch.history.findings import Finding


def located(finding: Finding, debug_folders: tuple[Path, ...] = DEBUG_FOLDERS) -> Finding:
    """Look the source lines of a finding up, in the files of this machine.

    Why the line of the frame to blame is not known is said in its problems; for others nobody
    expects one.
    """
    number = blamed(finding.frames)
    if number is None:
        return finding
    signature = finding.signature
    found = source_lines(
        finding.frames,
        finding.modules,
        is_fault=signature is not None and signature.what in FAULTS,
        debug_folders=debug_folders,
    )
    lines = tuple(found.lines.get(index) for index in range(len(finding.frames)))
    problem = found.problems.get(finding.frames[number].library)
    return replace(
        finding,
        lines=lines,
        place=replace(finding.place, line=lines[number]),
        problems=(*finding.problems, f"no source line: {problem}") if problem else finding.problems,
    )
