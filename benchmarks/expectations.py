"""What it costs to measure topics of which something is expected.

    python -m benchmarks.expectations [--topics N] [--rate HZ] [--seconds S] [--json]

Talkers in one isolated container, with and without `expect`: per cent of a CPU that the supervisor,
`topic_recorder` and the talkers take.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from pathlib import Path
from typing import Any

import psutil
import yaml

from benchmarks.running import running
from benchmarks.sampling import cpu_seconds
from play_launch.control.sessions import connect

SETTLED = 8.0
"""Seconds until all topics are measured."""


def configuration(topics: int, rate: float, *, is_expected: bool) -> str:
    nodes = [
        {
            "package": "play_launch_demo",
            "plugin": "play_launch_demo::Talker",
            "name": f"talker{number}",
            "remappings": {"chatter": f"/topic{number}"},
            "parameters": {"rate": rate},
        }
        for number in range(topics)
    ]
    expect = {"min_rate": 0.9 * rate, "max_gap": "1 s", "publishers": 1}
    return yaml.safe_dump(
        {
            "version": 1,
            "environment": {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"},
            "expect": {f"/topic{n}": expect for n in range(topics)} if is_expected else {},
            "containers": [
                {"name": "c", "container_type": "isolated", "composable_nodes": nodes},
            ],
        }
    )


def _usage(pid: int) -> dict[str, float]:
    """CPU seconds until now, by what used them."""
    found = {"supervisor": cpu_seconds(pid), "topic_recorder": 0.0, "nodes": 0.0}
    for child in psutil.Process(pid).children(recursive=True):
        key = "topic_recorder" if child.name() == "topic_recorder" else "nodes"
        found[key] += cpu_seconds(child.pid)
    return found


def measure(options: argparse.Namespace, *, is_expected: bool) -> dict[str, Any]:
    with tempfile.TemporaryDirectory(prefix="expect-") as name:
        config = Path(name) / "topics.yaml"
        config.write_text(configuration(options.topics, options.rate, is_expected=is_expected))
        with running(config, Path(name) / "logs", options.topics) as run:
            time.sleep(SETTLED)
            before = _usage(run.pid)
            time.sleep(options.seconds)
            after = _usage(run.pid)
            with connect(str(run.pid)) as client:
                rows = client.ask("expectations")
    percent = {key: 100 * (after[key] - before[key]) / options.seconds for key in after}
    return {"percent": percent, "met": sum(row["is_met"] is True for row in rows)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--topics", type=int, default=20)
    parser.add_argument("--rate", type=float, default=100.0)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    found = {
        "with": measure(options, is_expected=True),
        "without": measure(options, is_expected=False),
    }
    if options.json:
        print(json.dumps(found))
        return
    for what, each in found.items():
        used = ", ".join(f"{key} {value:.1f} %" for key, value in each["percent"].items())
        print(f"{what} expect: {used} ({each['met']} as expected)")


if __name__ == "__main__":
    main()
