"""What a SIGKILL of the supervisor under load costs its recording.

    python -m benchmarks.sigkill_recording [--runs N] [--floods N] [--lines N] [--json FILE]

Each run starts a system with two processes that print numbered lines as fast as asked, and a
container; begins another file of the recording every 30 kB; kills the supervisor at a random
moment; and completes the recording as the next start does. Then rosbags and mcap read all of it,
and @mcap/core in JavaScript where `just readers` installed it.

In the last runs, as many as ``--floods`` says, topics come at twice the speed of the disk: each
sync takes as long as a disk of DISK bytes a second needs for what was written since the one before.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
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
from play_launch.recording.topics import METADATA_NAME, OUTPUT
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
DISK = 5_000_000
"""Bytes a second."""
SLOW_DISK = f"""
import os, time
sync, synced = os.fdatasync, {{}}
def fdatasync(descriptor):
    status = os.fstat(descriptor)
    grown = status.st_size - synced.get(status.st_ino, 0)
    synced[status.st_ino] = status.st_size
    time.sleep(max(0, grown) / {DISK})
    sync(descriptor)
os.fdatasync = fdatasync
"""
"""Module ``sitecustomize`` of the supervisor."""
FLOOD = f"""
import array, time
import rclpy
from sensor_msgs.msg import Image
rclpy.init()
publisher = rclpy.create_node("flood").create_publisher(Image, "/flood", 10)
image = Image(data=array.array("B", bytes(500_000)))
due = time.monotonic()
while True:
    publisher.publish(image)
    due = max(due + len(image.data) / {2 * DISK}, time.monotonic())
    time.sleep(due - time.monotonic())
"""
CONFIG = """
version: 1
record: {{rotate: {{size: {size}}}, topics: [/flood], budget: 100 MB}}
containers:
  - name: chat
    composable_nodes:
      - {{package: play_launch_demo, plugin: "play_launch_demo::Talker", name: talker,
         parameters: {{rate: 50.0}}}}
nodes:
  - {{command: {command}, name: noise_1}}
  - {{command: {command}, name: noise_2}}
"""
FLOOD_NODE = "  - {{command: {flood}, name: flood}}\n"
READER = Path(__file__).parents[1] / "tests/recording/topic_recorder/reader/read.mjs"
HAS_JAVASCRIPT = bool(shutil.which("node")) and READER.with_name("node_modules").is_dir()
TIMEOUT = 60.0
CALM = 2.0
"""For each processor: with more, a thread waits for one."""
PROMISED = 0.25
"""Seconds."""


@dataclass(frozen=True)
class Killed:
    """What one run left."""

    lost: float
    """Seconds between the last message of the run itself in the recording and the kill."""
    flooded: int
    """Messages of the topic that comes too fast."""
    messages: int
    parts: int
    recovery: float
    """Seconds to complete what was cut off."""
    load: float
    """Processes that wanted a processor in the minute before, for each processor."""
    gaps: int
    """Lines that are missing before the last one of their process, or there twice."""


def kill_once(folder: Path, lines: float, after: float, *, is_flood: bool) -> Killed:
    """Run the system, kill its supervisor so many seconds after the first lines, and read on.

    In a flood, the time counts from the first message of the flood that was recorded.

    Raises whatever a reader raises that does not take the recording.
    """
    command = json.dumps([sys.executable, "-c", NOISE, str(2.0 / lines)])
    flood = json.dumps([sys.executable, "-c", FLOOD])
    config = folder / "killed.yaml"
    template = CONFIG + FLOOD_NODE if is_flood else CONFIG
    size = "20 MB" if is_flood else "30 kB"
    text = template.format(command=command, flood=flood, size=size)
    config.write_text(text, encoding="utf-8")
    slow = folder / "slow_disk"
    slow.mkdir()
    (slow / "sitecustomize.py").write_text(SLOW_DISK if is_flood else "", encoding="utf-8")
    logs = folder / "logs"
    process = subprocess.Popen(
        [COMMAND, "replay", config, "--log-dir", logs, "--json"],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=ENVIRONMENT | {"PYTHONPATH": f"{slow}:{ENVIRONMENT.get('PYTHONPATH', '')}"},
        text=True,
    )
    assert process.stdout is not None
    deadline = None
    with process.stdout as events:
        for line in events:
            if deadline is None and '"output"' in line and (not is_flood or is_flooded(logs)):
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
    last_ns, messages, flooded, gaps = read_all(session)
    return Killed(
        lost=(killed_ns - last_ns) / 1e9,
        messages=messages,
        flooded=flooded,
        parts=len(parts_of(session)),
        recovery=recovery,
        load=os.getloadavg()[0] / len(os.sched_getaffinity(0)),
        gaps=gaps,
    )


def is_flooded(logs: Path) -> bool:
    """Whether more than a second's worth of the flood is in the recording."""
    return sum(each.stat().st_size for each in logs.glob("*/*.mcap*")) > DISK


def read_all(session: Path) -> tuple[int, int, int, int]:
    """Read with all readers; return the run's last log time, messages, flood, and missing lines."""
    numbers: dict[str, list[int]] = {}
    counts: Counter[str] = Counter()
    with (session / BAG_NAME).open("rb") as file:
        heads = [one for one in make_reader(file).iter_metadata() if one.name == METADATA_NAME]
        # Killed before the first chunk, it lost everything since then.
        last = int(heads[0].metadata["started_ns"])
    with AnyReader([session]) as reader:
        for connection, log_time, raw in reader.messages():
            counts[connection.topic] += 1
            if connection.topic.startswith("/play_launch/"):
                last = max(last, log_time)
            if connection.topic == OUTPUT.name:
                message = reader.deserialize(raw, connection.msgtype)
                text = message.msg  # type: ignore[attr-defined]
                first = text.split(" ")[0]
                if first.isdecimal():
                    numbers.setdefault(message.name, []).append(int(first))  # type: ignore[attr-defined]
    paths = [part.path for part in parts_of(session)]
    by_mcap = sum(1 for path in paths for _ in read_with_mcap(path))
    if by_mcap != counts.total():
        raise RuntimeError(f"rosbags reads {counts.total()} messages, mcap {by_mcap}")
    if HAS_JAVASCRIPT:
        topics = [OUTPUT.name, "/flood"]
        by_javascript = sum(len(lines_of(["node", READER, path, *topics])) for path in paths)
        if by_javascript != sum(counts[topic] for topic in topics):
            raise RuntimeError(f"rosbags reads {counts}, JavaScript {by_javascript} of {topics}")
    gaps = sum(found != list(range(len(found))) for found in numbers.values())
    return last, counts.total(), counts["/flood"], gaps


def lines_of(command: list[str | Path]) -> list[str]:
    return subprocess.run(
        command, stdout=subprocess.PIPE, text=True, check=True, timeout=TIMEOUT
    ).stdout.splitlines()


def read_with_mcap(path: Path) -> Iterator[object]:
    with path.open("rb") as file:
        yield from make_reader(file, validate_crcs=True).iter_messages()


def measure(runs: int, floods: int, lines: float, seed: int) -> list[Killed]:
    moments = random.Random(seed)
    progress = Progress()
    results: list[Killed] = []
    for number in range(runs):
        with tempfile.TemporaryDirectory() as name:
            is_flood = number >= runs - floods
            after = moments.uniform(0.05, 1.5)
            results.append(kill_once(Path(name), lines, after, is_flood=is_flood))
        progress.tell(f"{number + 1} of {runs}")
    asyncio.run(sweep_shared_memory())
    return results


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--floods", type=int, default=25, help="of the runs")
    parser.add_argument("--lines", type=float, default=4000.0, help="a second, in all")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    results = measure(arguments.runs, arguments.floods, arguments.lines, arguments.seed)
    print(f"{len(results)} kills, {sum(one.messages for one in results):,} messages")
    print(f"read by rosbags, mcap{', @mcap/core' if HAS_JAVASCRIPT else ''}")
    print(header())
    print(row("lost before the kill", [1000 * one.lost for one in results], "ms"))
    print(row("completing the recording", [1000 * one.recovery for one in results], "ms"))
    print(row("files", [one.parts for one in results], ""))
    print(row("messages", [one.messages for one in results], ""))
    print(f"with missing or repeated lines: {sum(one.gaps > 0 for one in results)}")
    print(row("load of the machine, for each processor", [one.load for one in results], ""))
    floods = [1000 * one.lost for one in results if one.flooded]
    if floods:
        print(row(f"lost in a flood ({len(floods)} kills)", floods, "ms"))
    late = sum(one.lost > PROMISED for one in results)
    idle = [1000 * one.lost for one in results if one.load < CALM]
    if idle:
        print(row(f"lost at a load below {CALM:g} ({len(idle)} kills)", idle, "ms"))
    print(f"lost more than {1000 * PROMISED:.0f} ms: {late}")
    if arguments.json:
        arguments.json.write_text(json.dumps([vars(one) for one in results]), encoding="utf-8")


if __name__ == "__main__":
    main()
