"""The page of a running session: how soon it shows a crash, and what it costs.

    python -m benchmarks.web [--crashes N] [--seconds S] [--viewers N...] [--json]

120 units: 12 isolated containers of 9 nodes. A browser stands for each viewer, on the same CPUs.
Needs a Chromium.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import signal
import statistics
import tempfile
import time
from pathlib import Path
from typing import Any

import yaml

from benchmarks.browser import Browser, find_browser
from benchmarks.running import running
from benchmarks.sampling import cpu_seconds
from benchmarks.statistics import header
from play_launch.control.sessions import connect
from tests.cli.web.server import Server, serving

CONTAINERS, NODES = 12, 9
SETTLED = 6.0
"""Seconds until what the start of a page takes is over."""
SCRAPES = 100
SEEN = """
new Promise((done) => {
  const row = () => [...document.querySelectorAll('tbody tr')]
    .find((each) => each.innerText.includes('%s'))?.cells[3].innerText.trim();
  const look = () => row() === '%d' ? done(Date.now()) : setTimeout(look, 5);
  look();
})
"""


def configuration() -> str:
    talker = {"package": "play_launch_demo", "plugin": "play_launch_demo::Talker"}
    containers = [
        {
            "name": f"c{container}",
            "container_type": "isolated",
            "composable_nodes": [
                {**talker, "name": f"n{container}_{number}_"} for number in range(NODES)
            ],
        }
        for container in range(CONTAINERS)
    ]
    environment = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    return yaml.safe_dump(
        {"version": 1, "name": "viewed", "environment": environment, "containers": containers}
    )


def pid_of(supervisor: int, name: str) -> int:
    with connect(str(supervisor)) as client:
        return next(int(each["pid"]) for each in client.ask("ps") if each["name"] == name)


def latencies(supervisor: int, browser: Browser, crashes: int) -> list[float]:
    """Seconds from a crash to its row on the page."""
    found = []
    for number in range(crashes):
        name = f"/n{number % CONTAINERS}_{number // CONTAINERS}_"
        browser.run(f"void (window.seen = {SEEN % (name, 1)})")
        pid = pid_of(supervisor, name)
        begun = time.time()
        os.kill(pid, signal.SIGSEGV)
        found.append(browser.run("window.seen") / 1000 - begun)
    return found


def costs(supervisor: int, server: Server, seconds: float) -> tuple[float, float]:
    """Per cent of a CPU that the supervisor and the server take."""
    pids = (supervisor, server.process.pid)
    before = [cpu_seconds(pid) for pid in pids]
    time.sleep(seconds)
    after = [cpu_seconds(pid) for pid in pids]
    ours, page = (100 * (b - a) / seconds for a, b in zip(before, after, strict=True))
    return ours, page


def scrapes(supervisor: int, server: Server) -> tuple[float, ...]:
    """CPU milliseconds that a scrape of the metrics costs the supervisor and the server."""
    pids = (supervisor, server.process.pid)
    before = [cpu_seconds(pid) for pid in pids]
    for _ in range(SCRAPES):
        server.get("/metrics")
    after = [cpu_seconds(pid) for pid in pids]
    return tuple(1000 * (b - a) / SCRAPES for a, b in zip(before, after, strict=True))


def measure(options: argparse.Namespace) -> dict[str, Any]:
    program = find_browser()
    if program is None:
        raise SystemExit("the page needs Chromium (Debian: chromium)")
    with tempfile.TemporaryDirectory(prefix="web-") as name, contextlib.ExitStack() as opened:
        place = Path(name)
        config = place / "viewed.yaml"
        config.write_text(configuration())
        run = opened.enter_context(running(config, place / "logs", CONTAINERS * NODES))
        server = opened.enter_context(serving("--session", run.pid))
        time.sleep(SETTLED)
        found: dict[str, Any] = {"cpu": {}, "scrape_ms": scrapes(run.pid, server)}
        browsers: list[Browser] = []
        for viewers in sorted(options.viewers):
            while len(browsers) < viewers:
                profile = place / f"profile{len(browsers)}"
                browsers.append(opened.enter_context(Browser(program, profile)))
                browsers[-1].call("Page.navigate", url=server.url)
            for browser in browsers:
                browser.until("document.querySelectorAll('tbody tr').length > 100")
            time.sleep(SETTLED)
            found["cpu"][viewers] = costs(run.pid, server, options.seconds)
            if browsers and "crash_to_page" not in found:  # many browsers leave no CPU for one
                found["crash_to_page"] = latencies(run.pid, browsers[0], options.crashes)
        return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--crashes", type=int, default=20)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--viewers", type=int, nargs="+", default=[0, 1, 3])
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    found = measure(options)
    if options.json:
        print(json.dumps(found))
        return
    print(header())
    times = sorted(found["crash_to_page"])
    print(f"crash to page: median {statistics.median(times):.2f} s, most {times[-1]:.2f} s")
    supervisor, page = found["scrape_ms"]
    print(f"a scrape of the metrics: supervisor {supervisor:.1f} ms, page {page:.1f} ms")
    for viewers, (supervisor, page) in found["cpu"].items():
        print(f"{viewers} viewers: supervisor {supervisor:.1f} %, page {page:.1f} %")


if __name__ == "__main__":
    main()
