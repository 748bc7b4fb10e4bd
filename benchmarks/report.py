"""The page of a long session: how long `play-launch report` takes, how large it is, how it opens.

    python -m benchmarks.report [--runs N] [--hours H] [--nodes N] [--pictures FOLDER]

Opening and zooming are measured in the machine's Chromium, without a screen; unless it is
installed they are left out. With --pictures, screenshots of a short session go into that folder
instead.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.browser import Browser, find_browser
from benchmarks.goal import Goal
from benchmarks.long_session.plan import Plan
from benchmarks.long_session.write import write_session
from benchmarks.statistics import header, row

COMMAND = Path(sys.prefix) / "bin" / "play-launch"
WRITING = 10.0
OPENING = 3.0
LARGEST = 20.0
"""Goals: seconds, seconds, MB."""
SHORT = Plan(nodes=54, seconds=900.0, crashes=60, lines=20_000)
"""For the pictures."""
VIEW = (1360, 860)
ZOOM = """
(async () => {
  const frame = () => new Promise((done) => requestAnimationFrame(done));
  const taken = [];
  for (let step = 0; step < 16; step++) {
    const width = axis.whole / 2 ** (step % 8);
    const from = ((axis.whole - width) * ((step * 5) % 16)) / 16;
    const begin = performance.now();
    setRange(from, from + width);
    await frame();
    await frame();
    taken.push(performance.now() - begin);
  }
  return taken;
})()
"""
"""Milliseconds from a change of the range until the frame after it, sixteen times."""
SHOW_A_FAILURE = """
showFailure(facts.marks.findIndex((mark) => mark.what === "gave up") - 1);
setRange(0, axis.whole);
"""


def write(recording: Path, page: Path) -> tuple[float, float]:
    """Seconds of the command, and of CPU."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    begin = time.monotonic()
    subprocess.run([COMMAND, "report", recording, "-o", page], check=True, capture_output=True)
    wall = time.monotonic() - begin
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def look(browser: Browser, page: Path) -> dict[str, float]:
    """Seconds until it is drawn, and until the log is there as well; of zooming."""
    browser.open(page)
    seen = json.loads(
        browser.run(
            "JSON.stringify(Object.fromEntries(performance.getEntriesByType('mark')"
            ".map((mark) => [mark.name, mark.startTime / 1000])))"
        )
    )
    taken = sorted(browser.run(ZOOM))
    return {
        "drawn": seen["drawn"],
        "whole": seen["whole"],
        "zoom": taken[len(taken) // 2] / 1000,
        "longest zoom": taken[-1] / 1000,
    }


def pictures(folder: Path, program: str) -> None:
    """Take the pictures of the documentation."""
    with tempfile.TemporaryDirectory() as name:
        place = Path(name)
        write_session(place / "session.mcap", SHORT)
        subprocess.run([COMMAND, "report", "session.mcap"], cwd=place, check=True)
        with Browser(program, place / "profile") as browser:
            browser.size(*VIEW)
            for scheme in ("light", "dark"):
                browser.prefer(scheme)
                browser.open(place / "session.html")
                if scheme == "dark":
                    browser.run(SHOW_A_FAILURE)
                browser.drawn()
                picture = folder / f"report-{scheme}.png"
                browser.picture(picture)
                print(f"{picture}: {picture.stat().st_size / 1000:.0f} kB")


def measure(arguments: argparse.Namespace) -> None:
    plan = Plan(
        nodes=arguments.nodes,
        seconds=arguments.hours * 3600,
        crashes=round(Plan.crashes * arguments.hours),
        lines=round(Plan.lines * arguments.hours),
    )
    walls, cpus, views = [], [], []
    with tempfile.TemporaryDirectory() as name:
        place = Path(name)
        recording, page = place / "session.mcap", place / "page.html"
        messages = write_session(recording, plan)
        for _ in range(arguments.runs):
            wall, cpu = write(recording, page)
            walls.append(wall)
            cpus.append(cpu)
        program = find_browser()
        for number in range(arguments.runs if program else 0):
            assert program is not None
            with Browser(program, place / f"profile{number}") as browser:
                browser.size(*VIEW)
                views.append(look(browser, page))
        size = page.stat().st_size / 1e6
        print(
            f"{plan.nodes} nodes, {arguments.hours:g} h, {messages:,} messages in "
            f"{recording.stat().st_size / 1e6:.1f} MB, {os.cpu_count()} CPUs, {arguments.runs} runs"
        )
    print(header())
    print(row("play-launch report", walls, "s"))
    print(row("  CPU of it", cpus, "s"))
    for what in views[0] if views else ():
        print(row(f"in the browser: {what}", [view[what] for view in views], "s"))
    print(f"size of the page: {size:.1f} MB\n")
    goals = [
        Goal("`play-launch report`", f"{WRITING:g} s", f"{max(walls):.1f} s", max(walls) < WRITING),
        Goal("size", f"{LARGEST:g} MB", f"{size:.1f} MB", size < LARGEST),
    ]
    if views:
        opened = max(view["whole"] for view in views)
        goals.append(Goal("open", f"{OPENING:g} s", f"{opened:.1f} s", opened < OPENING))
    print("\n".join(goal.line for goal in goals))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--nodes", type=int, default=Plan.nodes)
    parser.add_argument("--hours", type=float, default=1.0)
    parser.add_argument("--pictures", type=Path, metavar="FOLDER")
    arguments = parser.parse_args()
    if arguments.pictures is None:
        measure(arguments)
        return
    program = find_browser()
    if program is None:
        parser.error("--pictures: there is no Chromium on this machine")
    pictures(arguments.pictures, program)


if __name__ == "__main__":
    main()
