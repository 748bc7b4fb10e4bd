"""The pictures of the documentation: what a person sees, made anew.

    python -m benchmarks.pictures [--only NAME...] [FOLDER]

They go into FOLDER, by default docs/: the demo while it comes up and when it is over, the screen of
`play-launch top`, also over three machines, which needs root, and the pages of `play-launch web`
and of a recorded session, which need a Chromium.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import yaml
from rich.console import Console
from rich.style import Style
from rich.text import Text

from benchmarks.bring_up import COMMAND, ENVIRONMENT
from benchmarks.browser import Browser, find_browser
from benchmarks.report import pictures as report_pictures
from benchmarks.running import running
from play_launch.cli.demo import with_page
from play_launch.cli.top.app import ScreenEnd, TopApp
from play_launch.control.sessions import connect
from tests.cli.web.server import serving
from tests.support.terminal import Terminal, on_terminal

ROOT = Path(__file__).parents[1]
CONFIG = "configs/demo.yaml"
CRASHING = "configs/crash_isolation.yaml"
NODES = 7
"""Of the latter."""
CRASHES = 9.0
"""Seconds in which some of them crash."""
UNFOLDING = 1.0
COLUMNS, LINES = 132, 40
TOP_SIZE = 100, 28
WEB_SIZE = 1000, 760
ANSWER = 30.0
"""Seconds for samples and lines of the session."""
SLOW = "waiting on /slow_starter … 2"
"""What the picture of a start is to show."""
REPORTER = """
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
rclpy.init()
node = rclpy.create_node("reporter")
publisher = node.create_publisher(DiagnosticArray, "/diagnostics", 10)
statuses = [
    DiagnosticStatus(level=level, name=name, message=text, hardware_id="front",
                     values=[KeyValue(key=key, value=value)])
    for level, name, text, key, value in [
        (b"\\0", "camera: frames", "30 a second", "dropped", "0"),
        (b"\\1", "lidar: temperature", "warm", "degrees", "61.5"),
    ]
]
node.create_timer(0.5, lambda: publisher.publish(DiagnosticArray(status=statuses)))
rclpy.spin(node)
"""
"""A node that reports what stands under Diagnostics."""
STYLES = {"bold": "bold", "italics": "italic", "reverse": "reverse"}
"""Marks of a cell, and rich's words for them."""


def seen(terminal: Terminal) -> Text:
    """What is on the screen, line by line, without empty lines at the end."""
    lines = terminal.lines()
    while lines and not lines[-1]:
        lines.pop()
    text = Text(no_wrap=True)
    for number, line in enumerate(lines):
        for column in range(len(line)):
            cell = terminal.look(number, column)
            text.append(cell.data, style_of(cell))
        text.append("\n")
    return text


def style_of(cell: Any) -> Style:
    """The style of a cell of the emulator."""
    words = [word for mark, word in STYLES.items() if getattr(cell, mark)]
    for colour, before in ((cell.fg, ""), (cell.bg, "on ")):
        if colour != "default":
            words.append(before + _colour(colour))
    return Style.parse(" ".join(words))


def _colour(name: str) -> str:
    """rich's word for a colour of the emulator: a name, or six hexadecimal digits."""
    if len(name) == 6 and all(digit in "0123456789abcdef" for digit in name):
        return f"#{name}"
    # The emulator's brown is the terminal's yellow.
    return name.replace("bright", "bright_").replace("brown", "yellow")


def drawn(text: Text, title: str) -> str:
    """An SVG of it."""
    with open(os.devnull, "w", encoding="utf-8") as nowhere:
        console = Console(record=True, file=nowhere, width=COLUMNS, force_terminal=True)
        console.print(text, end="", soft_wrap=True)
    return without_network(console.export_svg(title=title, unique_id="picture"))


def demo(folder: Path) -> None:
    """The demo, while it comes up and at its end."""
    title = f"play-launch replay {CONFIG}"
    environment = {**ENVIRONMENT, "PLAY_LAUNCH_LOG_DIR": "logs"}
    with tempfile.TemporaryDirectory() as place, contextlib.chdir(place):
        shutil.copytree(ROOT / "configs", "configs")
        command = (str(COMMAND), "replay", CONFIG)
        with on_terminal(*command, columns=COLUMNS, lines=LINES, **environment) as terminal:
            terminal.until_seen(SLOW)
            write(folder / "demo-live.svg", drawn(seen(terminal), title))
            terminal.end()
            write(folder / "demo.svg", drawn(seen(terminal), title))


def top(folder: Path) -> None:
    """The screen of a running session."""
    picture = folder / "top.svg"
    with (
        tempfile.TemporaryDirectory() as logs,
        running(ROOT / CRASHING, Path(logs), NODES) as run,
    ):
        time.sleep(CRASHES)
        with connect(str(run.pid)) as client:
            write(picture, asyncio.run(screenshot(TopApp(client))))


def machines(folder: Path) -> None:
    """The screen of a system of three machines."""
    with (
        tempfile.TemporaryDirectory() as logs,
        subprocess.Popen(
            [COMMAND, "demo", "--machines", "3", "--seconds", "60", "--quiet", "--log-dir", logs],
            stdout=subprocess.PIPE,
            text=True,
        ) as demonstration,
    ):
        assert demonstration.stdout is not None
        [*on_h1, _] = shlex.split(demonstration.stdout.readline().partition("shell: ")[2])
        subprocess.run([*on_h1, "wait", "--timeout", "40s"], check=True)
        with connect(str((Path(logs) / "latest").resolve())) as client:
            write(folder / "top-machines.svg", asyncio.run(screenshot(TopApp(client))))
        demonstration.send_signal(signal.SIGINT)


async def screenshot(app: TopApp) -> str:
    """An SVG of the screen, once it shows samples and lines."""
    pictures: list[str] = []

    async def take(pilot: Any) -> None:
        async with asyncio.timeout(ANSWER):
            while not (app.lines and any(row.cpu_percent is not None for row in app.rows or ())):
                await pilot.pause(0.1)
        await pilot.pause(0.2)
        pictures.append(app.export_screenshot(title=f"play-launch top: {app.hello.name}"))
        app.exit(ScreenEnd())

    await app.run_async(headless=True, size=TOP_SIZE, auto_pilot=take)
    return without_network(pictures[0])


def without_network(picture: str) -> str:
    """An SVG of rich, with the reader's own font instead of one that is fetched."""
    plain = re.sub(r" *@font-face \{[^}]*\}\n", "", picture)
    return plain.replace("Fira Code, monospace", "monospace")


def web(folder: Path) -> None:
    """The page of a running session, what it found, and one unit."""
    with (
        tempfile.TemporaryDirectory() as place,
        running(ROOT / CRASHING, Path(place) / "logs", NODES) as run,
        serving("--session", run.pid, "--allow-control", count=2) as server,
        Browser(_browser(), Path(place) / "profile") as browser,
    ):
        browser.size(*WEB_SIZE)
        browser.call("Page.navigate", url=server.invitations[-1])
        time.sleep(CRASHES)
        browser.picture(folder / "web.png")
        browser.run("document.querySelector('.q-expansion-item .q-item').click()")
        browser.until("document.body.innerText.includes('Backtrace:')")
        labels = "document.querySelectorAll('.q-expansion-item .nicegui-column div')"
        without = f"each.textContent = each.textContent.replaceAll('{ROOT}/', '')"
        browser.run(f"{labels}.forEach((each) => {{ {without} }})")
        browser.run("document.querySelector('.q-table__container').remove()")
        browser.picture(folder / "web-findings.png")
        browser.call("Page.reload")
        unit = (
            "[...document.querySelectorAll('button')].find((each) => /talker/.test(each.innerText))"
        )
        browser.until(f"{unit} !== undefined")
        browser.run(f"{unit}.click()")
        browser.until("document.querySelector('.q-dialog').innerText.includes('Declared')")
        browser.run("document.querySelector('.q-dialog .q-expansion-item .q-item').click()")
        browser.until("document.querySelector('.q-dialog').innerText.includes('New value')")
        browser.picture(folder / "web-unit.png")


def graph(folder: Path) -> None:
    """The page of `play-launch demo --web`: what does not connect, and how it came up."""
    config = with_page()
    del config["web"], config["duration"]  # it is served, and ended, below
    reporter = {"name": "reporter", "command": [sys.executable, "-c", REPORTER]}
    config["nodes"] = [*config.get("nodes", ()), reporter]
    nodes = sum(len(each["composable_nodes"]) for each in config["containers"])
    with tempfile.TemporaryDirectory() as name, contextlib.ExitStack() as opened:
        place = Path(name)
        (place / "demo.yaml").write_text(yaml.safe_dump(config))
        run = opened.enter_context(running(place / "demo.yaml", place / "logs", nodes))
        server = opened.enter_context(serving("--session", run.pid))
        browser = opened.enter_context(Browser(_browser(), place / "profile"))
        browser.size(*WEB_SIZE)
        browser.call("Page.navigate", url=server.url)
        browser.until("document.querySelectorAll('tbody tr').length > 5")
        for panel, text in (
            ("Diagnostics", "warm"),
            ("Connections", "reliab"),
            ("Topics", "broken"),
        ):
            browser.run(
                "[...document.querySelectorAll('.q-expansion-item .q-item')]"
                f".find((each) => each.innerText.includes('{panel}')).click()"
            )
            browser.until(f"document.body.innerText.includes('{text}')")
        browser.run("document.querySelector('.q-table__container').remove()")
        time.sleep(UNFOLDING)
        browser.picture(folder / "web-graph.png")
        link = "[...document.querySelectorAll('a')].find((each) => each.innerText === 'Bring-up')"
        browser.call("Page.navigate", url=browser.run(f"{link}.href"))
        browser.until("document.documentElement.dataset.ready === 'yes'")
        browser.picture(folder / "web-bring-up.png")


def report(folder: Path) -> None:
    """The page of a recorded session, in light and in dark."""
    report_pictures(folder, _browser())


def _browser() -> str:
    program = find_browser()
    if program is None:
        raise SystemExit("the page of a session needs Chromium (Debian: chromium)")
    return program


def write(path: Path, picture: str) -> None:
    path.write_text(picture, encoding="utf-8")
    print(path)


MAKERS: Mapping[str, Callable[[Path], None]] = {
    "demo": demo,
    "top": top,
    "machines": machines,
    "web": web,
    "graph": graph,
    "report": report,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", nargs="?", type=Path, default=ROOT / "docs")
    parser.add_argument("--only", nargs="+", choices=MAKERS, default=list(MAKERS))
    options = parser.parse_args()
    for name in options.only:
        MAKERS[name](options.folder.resolve())


if __name__ == "__main__":
    main()
