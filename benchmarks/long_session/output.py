"""What the nodes of the made-up session write."""

from __future__ import annotations

import random
from collections.abc import Iterator
from heapq import merge

from benchmarks.long_session.plan import Robot, Timed, stamp
from play_launch.supervisor.events import OutputLine, Stream

WORDS = (
    *("scan received with", "published pose", "transform is late by", "queue length", "retry"),
    *("dropped frame", "goal accepted", "cost of the new plan", "battery at", "buffer size"),
)
LAST_WORDS = 20
"""Lines that a node writes in the second before it crashes."""


def output(robot: Robot) -> Iterator[Timed]:
    """Give the lines in order: evenly over the time, and more before a crash."""
    source = random.Random(robot.plan.seed + 1)
    nodes = [life.key for life in robot.lives if life.kind == "node"]
    seconds, count = robot.plan.seconds, robot.plan.lines
    evenly = ((seconds * (i + source.random()) / count, "") for i in range(count))
    before_death = sorted(
        (at - 1 + i / LAST_WORDS, f"{container}:{node}")
        for at, container, node in robot.deaths
        for i in range(LAST_WORDS)
    )
    for at, dying in merge(evenly, before_death):
        container, node = (dying or source.choice(nodes)).split(":")
        shares = (0, 30, 70) if dying else (94, 5, 1)
        level = source.choices(("INFO", "WARN", "ERROR"), shares)[0]
        text = (
            f"[{level}] [{stamp(at) / 1e9:.9f}] [{node[1:].replace('/', '.')}]: "
            f"{source.choice(WORDS)} {source.getrandbits(16)}, "
            f"{source.choice(WORDS)} {source.random() * 100:.3f}"
        )
        line = OutputLine(
            stamp_ns=stamp(at), process=container, pid=0, stream=Stream.STDERR, text=text
        )
        yield at, line
