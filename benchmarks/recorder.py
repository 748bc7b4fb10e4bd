"""What recording topics of ROS takes: messages and bytes a second, drops, CPU of those involved.

    python -m benchmarks.recorder [--seconds N] [--cases NAME...] [--json]

Each case runs publishers in containers of their own and records them. The CPU times are those of
the supervisor, its recorder included, and of the program that takes the messages, after the first
seconds. With rosbag2 on the machine, `ros2 bag record` records the same publishers; its CPU
stands beside it.
"""

from __future__ import annotations

import argparse
import json
import shutil
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import psutil
from mcap.reader import make_reader

from benchmarks.running import running
from benchmarks.sampling import cpu_seconds

SETTLED = 5.0
FULL_HD = 1920 * 1080 * 3
TOPIC = "/load"


class Case(NamedTuple):
    """Publishers of one kind; `rate` in Hz and `size` in bytes of each message."""

    plugin: str
    rate: float
    size: int
    publishers: int = 1
    record: str = f"{{topics: ['{TOPIC}*']}}"


CASES = {
    "nothing": Case("Talker", 0.001, 0),
    "not recorded: 1080p RGB at 30 Hz": Case("ImageSource", 30.0, FULL_HD, record="{ros: false}"),
    "1080p RGB at 30 Hz": Case("ImageSource", 30.0, FULL_HD),
    "held: 1080p RGB at 30 Hz": Case(
        "ImageSource", 30.0, FULL_HD, record=f"{{before_crash: {{topics: ['{TOPIC}*']}}}}"
    ),
    "VGA RGB at 30 Hz": Case("ImageSource", 30.0, 640 * 480 * 3),
    "not recorded: small at 1 kHz": Case("Talker", 1000.0, 0, record="{ros: false}"),
    "small at 1 kHz": Case("Talker", 1000.0, 0),
    "10 x small at 1 kHz": Case("Talker", 1000.0, 0, publishers=10),
}


def configuration(case: Case) -> str:
    lines = ["version: 1", f"record: {case.record}", "containers:"]
    topic = "image" if case.plugin == "ImageSource" else "chatter"
    parameters = f"rate: {case.rate}"
    parameters += f", bytes: {case.size}" if case.size else ""
    for number in range(case.publishers):
        lines += [
            f"  - name: c{number}",
            "    composable_nodes:",
            "      - package: play_launch_demo",
            f"        plugin: play_launch_demo::{case.plugin}",
            f"        name: source{number}",
            f"        parameters: {{{parameters}}}",
            f"        remappings: {{{topic}: {TOPIC}{number}}}",
        ]
    return "\n".join(lines) + "\n"


def recorder_of(pid: int) -> psutil.Process | None:
    """The program that takes the messages, below this supervisor."""
    for child in psutil.Process(pid).children(recursive=True):
        if child.name() == "topic_recorder":
            return child
    return None


def measure(case: Case, folder: Path, seconds: float) -> Mapping[str, float]:
    config = folder / "config.yaml"
    config.write_text(configuration(case), encoding="utf-8")
    with running(config, folder / "log", case.publishers) as run:
        time.sleep(SETTLED)
        program = recorder_of(run.pid)
        pids = [run.pid, *([program.pid] if program else [])]
        before, begin, begin_ns = [cpu_seconds(pid) for pid in pids], time.monotonic(), now_ns()
        time.sleep(seconds)
        used = [cpu_seconds(pid) - cpu for pid, cpu in zip(pids, before, strict=True)]
        elapsed, end_ns = time.monotonic() - begin, now_ns()
        memory = program.memory_info().rss if program else 0
    summary = run.last["recording"]
    messages, size = recorded(folder / "log" / "latest", begin_ns, end_ns)
    return {
        "messages/s": messages / elapsed,
        "MB/s": size / elapsed / 1e6,
        "of those sent %": 100 * messages / (case.rate * case.publishers * elapsed),
        "dropped": summary["topic_drops"],
        "supervisor % of a core": 100 * used[0] / elapsed,
        "topic_recorder % of a core": 100 * sum(used[1:]) / elapsed,
        "topic_recorder MB": memory / 1e6,
    }


def now_ns() -> int:
    return time.time_ns()


def recorded(folder: Path, begin_ns: int, end_ns: int) -> tuple[int, int]:
    """Messages and bytes of the load in that time, in all files of a session."""
    messages = size = 0
    for path in folder.glob("*.mcap"):
        with path.open("rb") as file:
            for _, channel, message in make_reader(file).iter_messages(log_time_order=False):
                if channel.topic.startswith(TOPIC) and begin_ns <= message.log_time < end_ns:
                    messages += 1
                    size += len(message.data)
    return messages, size


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--cases", nargs="*", default=list(CASES), choices=list(CASES))
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()

    figures: dict[str, Mapping[str, float]] = {}
    for name in options.cases:
        with tempfile.TemporaryDirectory(prefix="recorder-") as folder:
            figures[name] = measure(CASES[name], Path(folder), options.seconds)
    if options.json:
        print(json.dumps(figures))
        return
    for name, values in figures.items():
        print(f"\n{name}")
        for what, value in values.items():
            print(f"  {what:<28} {value:10.1f}")
    if shutil.which("ros2") is None:
        print("\nros2 bag record: not on this machine")


if __name__ == "__main__":
    main()
