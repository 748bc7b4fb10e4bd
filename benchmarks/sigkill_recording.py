"""What a SIGKILL of the supervisor under load costs its recording.

    python -m benchmarks.sigkill_recording [--runs N] [--lines N] [--json FILE]

Each run starts a system with two processes that print numbered lines as fast as asked, and a
container; begins another file of the recording every 30 kB; kills the supervisor at a random
moment; and completes the recording as the next start does. Then rosbags and mcap read all of it.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import psutil
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from benchmarks.progress import Progress
from benchmarks.statistics import header, row
from play_launch.postmortem.archive import complete_files
from play_launch.recording.folder import BAG_NAME, parts_of
from play_launch.recording.session import METADATA_NAME
from play_launch.recording.topics import OUTPUT
from play_launch.ros.fastdds.shared_memory import sweep_shared_memory

COMMAND = Path(sys.prefix) / "bin" / "play-launch"
ENVIRONMENT = {
    **os.environ,
    "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
    "ROS_DOMAIN_ID": os.environ.get("ROS_DOMAIN_ID", "97"),
}
NOISE = """
import sys, time
gap, number, due = float(sys.argv[1]), 0, time.monotonic()
while True:
    print(number, "x" * 60, flush=True)
    number, due = number + 1, due + gap
    time.sleep(max(0.0, due - time.monotonic()))
"""
CONFIG = """
version: 1
record: {{rotate: {{size: 30 kB}}}}
containers:
  - name: chat
    composable_nodes:
      - {{package: play_launch_demo, plugin: "play_launch_demo::Talker", name: talker,
         parameters: {{rate: 50.0}}}}
nodes:
  - {{command: {command}, name: noise_1}}
  - {{command: {command}, name: noise_2}}
"""
TIMEOUT = 60.0
CALM = 2.0
"""For each processor: with more, a thread waits for one."""
PROMISED = 0.25
"""Seconds."""


@dataclass(frozen=True)
class Killed:
    """What one run left."""

    lost: float
    """Seconds between the last message in the recording and the kill."""
    messages: int
    parts: int
    recovery: float
    """Seconds to complete what was cut off."""
    load: float
    """Processes that wanted a processor in the minute before, for each processor."""
    gaps: int
    """Lines that are missing before the last one of their process, or there twice."""


def kill_once(folder: Path, lines: float, after: float) -> Killed:
    """Run the system, kill its supervisor so many seconds after the first lines, and read on.

    Raises whatever a reader raises that does not take the recording.
    """
    command = json.dumps([sys.executable, "-c", NOISE, str(2.0 / lines)])
    config = folder / "killed.yaml"
    config.write_text(CONFIG.format(command=command), encoding="utf-8")
    logs = folder / "logs"
    process = subprocess.Popen(
        [COMMAND, "replay", config, "--log-dir", logs, "--json"],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=ENVIRONMENT,
        text=True,
    )
    assert process.stdout is not None
    deadline = None
    with process.stdout as events:
        for line in events:
            if deadline is None and '"output"' in line:
                deadline = time.monotonic() + after
            if deadline is not None and time.monotonic() >= deadline:
                break
        others = psutil.Process(process.pid).children(recursive=True)
        killed_ns = time.time_ns()
        process.send_signal(signal.SIGKILL)
        process.wait()
    _, alive = psutil.wait_procs(others, timeout=TIMEOUT)
    if alive:
        raise RuntimeError(f"still there after {TIMEOUT} s: {alive}")
    session = (logs / "latest").resolve()
    begin = time.monotonic()  # all its children are gone, and with them the locks that they had
    complete_files(session)
    recovery = time.monotonic() - begin
    last_ns, messages, gaps = read_all(session)
    return Killed(
        lost=(killed_ns - last_ns) / 1e9,
        messages=messages,
        parts=len(parts_of(session)),
        recovery=recovery,
        load=os.getloadavg()[0] / len(os.sched_getaffinity(0)),
        gaps=gaps,
    )


def read_all(session: Path) -> tuple[int, int, int]:
    """Read with rosbags and with mcap; return the last log time, messages, and missing lines."""
    numbers: dict[str, list[int]] = {}
    count = 0
    with (session / BAG_NAME).open("rb") as file:
        heads = [one for one in make_reader(file).iter_metadata() if one.name == METADATA_NAME]
        # Killed before the first chunk, it lost everything since then.
        last = int(heads[0].metadata["started_ns"])
    with AnyReader([session]) as reader:
        for connection, log_time, raw in reader.messages():
            last, count = max(last, log_time), count + 1
            if connection.topic == OUTPUT.name:
                message = reader.deserialize(raw, connection.msgtype)
                text = message.msg  # type: ignore[attr-defined]
                first = text.split(" ")[0]
                if first.isdecimal():
                    numbers.setdefault(message.name, []).append(int(first))  # type: ignore[attr-defined]
    by_mcap = sum(1 for part in parts_of(session) for _ in read_with_mcap(part.path))
    if by_mcap != count:
        raise RuntimeError(f"rosbags reads {count} messages, mcap {by_mcap}")
    gaps = sum(found != list(range(len(found))) for found in numbers.values())
    return last, count, gaps


def read_with_mcap(path: Path) -> Iterator[object]:
    with path.open("rb") as file:
        yield from make_reader(file, validate_crcs=True).iter_messages()


def measure(runs: int, lines: float, seed: int) -> list[Killed]:
    moments = random.Random(seed)
    progress = Progress()
    results: list[Killed] = []
    for number in range(runs):
        with tempfile.TemporaryDirectory() as name:
            results.append(kill_once(Path(name), lines, moments.uniform(0.05, 1.5)))
        progress.tell(f"{number + 1} of {runs}")
    asyncio.run(sweep_shared_memory())
    return results


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--lines", type=float, default=4000.0, help="a second, in all")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    results = measure(arguments.runs, arguments.lines, arguments.seed)
    print(f"{len(results)} kills, {sum(one.messages for one in results):,} messages")
    print(header())
    print(row("lost before the kill", [1000 * one.lost for one in results], "ms"))
    print(row("completing the recording", [1000 * one.recovery for one in results], "ms"))
    print(row("files", [one.parts for one in results], ""))
    print(row("messages", [one.messages for one in results], ""))
    print(f"with missing or repeated lines: {sum(one.gaps > 0 for one in results)}")
    print(row("load of the machine, for each processor", [one.load for one in results], ""))
    late = sum(one.lost > PROMISED for one in results)
    idle = [1000 * one.lost for one in results if one.load < CALM]
    if idle:
        print(row(f"lost at a load below {CALM:g} ({len(idle)} kills)", idle, "ms"))
    print(f"lost more than {1000 * PROMISED:.0f} ms: {late}")
    if arguments.json:
        arguments.json.write_text(json.dumps([vars(one) for one in results]), encoding="utf-8")


if __name__ == "__main__":
    main()
