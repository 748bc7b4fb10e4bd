"""``play-launch doctor``: what this machine can do, and what to do about what it cannot."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict
from typing import TYPE_CHECKING, Final

from play_launch.cli import options
from play_launch.cli.output import say, surviving_the_reader, wants_colour
from play_launch.supervisor.exit_code import ExitCode

if TYPE_CHECKING:
    from collections.abc import Sequence
    from typing import IO

    from play_launch.doctor.finding import Finding

_PIPE_WIDTH: Final = 120
_COLOURS: Final = {"ok": "green", "warn": "yellow", "fail": "red"}


def doctor(
    as_json: options.Json = False,
) -> int:
    """Check this machine: what works, what does not, the impact, and the fix.

    The container program is started once; nothing is changed. Exits with 1 if no system can be
    started here.
    """
    from play_launch.doctor.finding import can_run  # noqa: PLC0415
    from play_launch.doctor.report import examine  # noqa: PLC0415

    findings = examine()
    runs = can_run(findings)
    if as_json:
        values = {"can_run": runs, "findings": [asdict(finding) for finding in findings]}
        say(json.dumps(values, ensure_ascii=False))
    else:
        with surviving_the_reader():
            print_findings(findings, sys.stdout, colour=wants_colour(sys.stdout))
            sys.stdout.flush()
    return ExitCode.OK if runs else ExitCode.NODE_FAILED


def print_findings(findings: Sequence[Finding], stream: IO[str], *, colour: bool) -> None:
    """Print a table, and below it one line of result."""
    from rich import box  # noqa: PLC0415
    from rich.console import Console  # noqa: PLC0415
    from rich.table import Table  # noqa: PLC0415
    from rich.text import Text  # noqa: PLC0415

    console = Console(
        file=stream,
        width=None if stream.isatty() else _PIPE_WIDTH,
        no_color=not colour,
        force_terminal=colour,
        highlight=False,
    )
    table = Table(box=box.SIMPLE, show_header=False, pad_edge=False)
    table.add_column(no_wrap=True)
    table.add_column(no_wrap=True)
    table.add_column(overflow="fold")
    for finding in findings:
        says = Text(finding.says)
        if finding.impact:
            says.append(f"\nimpact: {finding.impact}", "dim")
        if finding.fix:
            says.append(f"\nfix: {finding.fix}", "bold")
        level = Text(finding.level.value, _COLOURS[finding.level.value])
        table.add_row(level, finding.subject, says)
    console.print(table)
    console.print(Text(_result(findings)))


def _result(findings: Sequence[Finding]) -> str:
    failed = [finding.subject for finding in findings if finding.level.value == "fail"]
    if failed:
        return f"No system can be brought up here: {', '.join(failed)}."
    warned = sum(finding.level.value == "warn" for finding in findings)
    return f"Systems can be brought up here; {warned or 'no'} warning{'' if warned == 1 else 's'}."
