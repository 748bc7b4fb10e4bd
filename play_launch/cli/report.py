"""A page of a recording."""

from __future__ import annotations

from typing import TYPE_CHECKING

from play_launch import ExitCode
from play_launch.cli import options
from play_launch.cli.explain import details, headline
from play_launch.cli.info import report_damage
from play_launch.cli.output import say, size, write_file
from play_launch.postmortem.findings import findings
from play_launch.postmortem.report.facts import Point, contents
from play_launch.postmortem.report.gather import Gathered
from play_launch.postmortem.report.page import render
from play_launch.postmortem.source_lines import located
from play_launch.postmortem.timeline import Timeline
from play_launch.recording.folder import beside

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from play_launch.postmortem.findings import Finding


def report(file: options.Recording, output: options.OutputBeside = None) -> int:
    """Write an HTML page about a recording: events, timeline, CPU and memory, log, configuration.

    It is one file for any browser, and needs no network. An existing file is replaced. Damaged and
    unfinished recordings (.active) are read as far as possible; the page names the damage, and
    exits with 5 then, with 2 if the file is not a recording, with 1 if the page cannot be written.
    """
    output = output or beside(file, ".html")
    timeline = Timeline(file)
    gathered = Gathered(timeline)
    gathered.read()
    points = tuple(_points(findings(timeline), timeline.session.started_ns))
    count = write_file(output, render(contents(gathered, points)))
    say(f"{output}: {size(count)}", beside=output)
    return ExitCode.DAMAGED if report_damage(timeline.session.reader) else 0


def _points(found: Sequence[Finding], started_ns: int) -> Iterator[Point]:
    for finding in located(found):
        yield Point(
            headline(finding, started_ns),
            tuple(details(finding)),
            (finding.at_ns - started_ns) / 1e6,
            finding.name,
            finding.is_failure,
        )
