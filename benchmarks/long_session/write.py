"""The made-up session, written as a recorder writes it."""

from __future__ import annotations

import json
from heapq import merge
from operator import itemgetter
from pathlib import Path

from benchmarks.long_session.output import output
from benchmarks.long_session.plan import AREAS, BEGIN, PROCESSES, Plan, container_of, names
from benchmarks.long_session.samples import samples
from benchmarks.long_session.story import make_up
from play_launch.recording import topics
from play_launch.recording.bag import BagWriter
from play_launch.recording.forms import convert
from play_launch.recording.topics import METADATA_NAME

CHUNK = 0.25
"""Seconds after which a chunk ends, as it does in the recorder."""
RECEIPT = 100_000
"""Nanoseconds from an event to its receipt."""


def write_session(path: Path, plan: Plan) -> int:
    """Write the recording; it must not exist. Return how many messages it has."""
    robot = make_up(plan)
    writer = BagWriter(path)
    _write_head(writer, plan)
    channels = {topic: writer.register(topic) for topic in topics.ALL_TOPICS}
    chunk_ends = CHUNK
    happened = merge(robot.events, output(robot), samples(robot), key=itemgetter(0))
    for at, event in happened:
        if at > chunk_ends:
            writer.flush()
            chunk_ends = at + CHUNK
        for topic, data, _ in convert(event):
            if topic not in channels:
                channels[topic] = writer.register(topic)
            stamp = event.stamp_ns
            writer.write(channels[topic], data, log_time=stamp + RECEIPT, publish_time=stamp)
    writer.close()
    return writer.messages


def _write_head(writer: BagWriter, plan: Plan) -> None:
    containers = [
        {
            "name": container_of(area)[1:],
            "container_type": "isolated",
            "composable_nodes": [
                {
                    "package": f"{area}_nodes",
                    "plugin": f"{area}::{name.split('/')[2].title()}",
                    "name": name.split("/")[2],
                    "namespace": f"/{area}",
                }
                for name in names(plan)
                if name.startswith(f"/{area}/")
            ],
        }
        for area in AREAS[: plan.nodes]
    ]
    nodes = [{"name": name[1:], "command": ["python3", f"{name[1:]}.py"]} for name in PROCESSES]
    config = {"version": 1, "name": "long_session", "containers": containers, "nodes": nodes}
    host = {"hostname": "robot", "kernel": "6.1", "cpus": 8}
    # JSON is YAML, too.
    files = {"config.yaml": config, "resolved_config.json": config, "host.json": host}
    for name, content in files.items():
        text = json.dumps(content, indent=2).encode()
        writer.attach(name, "application/json", text, time=BEGIN)
    about = {
        "schema_version": "1",
        "id": f"long-session-{plan.seed}",
        "name": "long_session",
        "started_ns": str(BEGIN),
        "argv": '["play-launch", "replay", "robot.yaml"]',
        "play_launch_version": "0.1.0",
    }
    writer.metadata(METADATA_NAME, about)
