"""What a made-up session consists of."""

from __future__ import annotations

import random
from dataclasses import dataclass, field

from play_launch.supervisor.events import RunEvent

BEGIN = 1_790_000_000_000_000_000
"""When it begins: nanoseconds since the epoch."""
AREAS = (
    *("lidar", "camera", "planner", "controller", "map", "arm", "battery", "slam", "bridge", "imu"),
)
ROLES = (
    *("driver", "filter", "monitor", "server", "client", "fusion", "relay", "watch", "sync"),
    *("proxy", "logger", "tracker"),
)
PROCESSES = ("/dashboard", "/uploader")

Timed = tuple[float, RunEvent]
"""Seconds after the begin, and what happened then."""


@dataclass(frozen=True)
class Plan:
    """What the session is to be; the defaults are those of a large robot."""

    nodes: int = 110
    seconds: float = 3600.0
    crashes: int = 150
    lines: int = 200_000
    seed: int = 1
    period: float = 1.0
    """Seconds between two samples."""


@dataclass(frozen=True, slots=True)
class Life:
    """One process of a node, a container or an executable, from its start to its end."""

    kind: str
    key: str
    pid: int
    begin: float
    end: float
    leaks: bool = False


@dataclass(slots=True)
class Robot:
    """The session as it is made up: events, and which processes there were."""

    plan: Plan
    random: random.Random
    events: list[Timed] = field(default_factory=list)
    lives: list[Life] = field(default_factory=list)
    deaths: list[tuple[float, str, str]] = field(default_factory=list)
    """When, which container, which node."""
    attempts: int = 0
    pids: int = 4000

    def at(self, seconds: float, event: RunEvent) -> None:
        self.events.append((seconds, event))

    def pid(self) -> int:
        self.pids += 1
        return self.pids


def stamp(seconds: float) -> int:
    return BEGIN + round(seconds * 1e9)


def names(plan: Plan) -> list[str]:
    """Full names of the nodes, in areas of the robot."""
    return [f"/{AREAS[i % 10]}/{ROLES[i // 10 % 12]}{i // 120 or ''}" for i in range(plan.nodes)]


def container_of(area: str) -> str:
    return f"/{area}_container"
