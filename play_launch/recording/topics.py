"""The topics of a session recording, and the definitions of their messages.

They live in a namespace of their own, so that playing a recording back cannot disturb a running
system: nothing subscribes to ``/play_launch`` but readers of recordings.

A reader of a bag has no ROS installation to ask, so a schema carries the definition of its type,
from the installed ``.msg`` file, followed by those of all types it uses, each under a line of 80
``=`` and ``MSG: package/Name``: encoding ``ros2msg`` of the MCAP registry, as rosbag2 writes it.
"""

from __future__ import annotations

import os
import re
import sys
from collections import deque
from functools import cache
from pathlib import Path
from typing import Final

from msgspec import Struct

from play_launch.config.substitutions import ament_prefixes
from play_launch.container.cdr.structure import DEFINITIONS
from play_launch.recording.errors import SchemaNotFoundError
from play_launch.supervisor.events import SubjectKind

KIND: Final = "play_launch.kind"
KEY: Final = "play_launch.key"
"""Metadata of a channel: see `Topic.about`."""
PROCESS_STATS: Final = "play_launch_msgs/msg/ProcessStats"
GROUP_STATS: Final = "play_launch_msgs/msg/GroupStats"
METADATA_NAME: Final = "play_launch.session"
MACHINES_METADATA: Final = "play_launch.machines"
"""A merged recording has it, with the nanoseconds by which each machine's recording was
ahead at the end."""
PART_METADATA: Final = "play_launch.part"
"""Every file but the first has it, with its ``number`` (from 1 on), and ``first``, as many files
were removed at the beginning; a merged recording with those of all machines."""
DROPS_METADATA: Final = "play_launch.topic_drops"
"""Metadata record: number of messages of each topic that are not in the bag; absent without any."""
RESOLVED: Final = "resolved_config.json"
APPLIED: Final = "applied/"
"""Begins the names of attachments of a configuration that was applied, before its number."""
REPEATED: Final = 0
"""Sequence number of messages that repeat the latest ones of the files before; others have
higher ones."""
_SEPARATOR: Final = "=" * 80
_PRIMITIVES: Final = frozenset(
    {"bool", "byte", "char", "float32", "float64", "string", "wstring"}
    | {f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)}
)
_FIELD: Final = re.compile(
    r"^\s*(?P<type>[A-Za-z][A-Za-z0-9_/]*)"  # a comment begins with #, so it does not match
    r"(?:<=\d+)?(?:\[[^\]]*\])?"  # bound of a string, then array
    r"\s+[A-Za-z]"  # the field's name
)
_NOT_IN_A_NAME: Final = re.compile(r"[^A-Za-z0-9_]+")
_INFINITE: Final = "{sec: 9223372036, nsec: 854775807}"
_KEEP_LAST: Final = 1
_RELIABLE: Final = 1
_TRANSIENT_LOCAL: Final = 1
_VOLATILE: Final = 2
_LIVELINESS_AUTOMATIC: Final = 1


class Topic(Struct, frozen=True):
    """A recorded topic: its name, its message type and what a publisher would offer."""

    name: str
    type_name: str
    """``package/msg/Name``."""
    depth: int = 1000
    latched: bool = False
    """True for durability ``transient_local``."""
    about: tuple[SubjectKind, str] | None = None
    """Kind and key, as in StateEvent, of the one thing that all of its messages are about."""

    offered: str = ""
    """The quality of service that its publishers really offer, as ``offered_qos_profiles``."""

    @property
    def metadata(self) -> dict[str, str]:
        """What the bag says about it."""
        values = {"offered_qos_profiles": self.offered_qos_profiles}
        if self.about is not None:
            kind, key = self.about
            values |= {KIND: kind.name.lower(), KEY: key}
        return values

    @property
    def offered_qos_profiles(self) -> str:
        """The quality of service as YAML, as rosbag2 stores it beside a channel.

        The policies are written as numbers: every rosbag2 from Foxy on reads those, while the
        words are understood from Jazzy on only.
        """
        return self.offered or (
            f"- history: {_KEEP_LAST}\n"
            f"  depth: {self.depth}\n"
            f"  reliability: {_RELIABLE}\n"
            f"  durability: {_TRANSIENT_LOCAL if self.latched else _VOLATILE}\n"
            f"  deadline: {_INFINITE}\n"
            f"  lifespan: {_INFINITE}\n"
            f"  liveliness: {_LIVELINESS_AUTOMATIC}\n"
            f"  liveliness_lease_duration: {_INFINITE}\n"
            "  avoid_ros_namespace_conventions: false"
        )


COMPONENT_EVENTS: Final = Topic(
    "/play_launch/events", "play_launch_msgs/msg/ComponentEvent", depth=100, latched=True
)
STATES: Final = Topic("/play_launch/states", "play_launch_msgs/msg/StateEvent", latched=True)
GRAPH: Final = Topic("/play_launch/graph", "play_launch_msgs/msg/GraphEvent")
ACTIONS: Final = Topic("/play_launch/actions", "play_launch_msgs/msg/ActionEvent")
OUTPUT: Final = Topic("/play_launch/output", "rcl_interfaces/msg/Log")
LOG: Final = Topic("/play_launch/log", "rcl_interfaces/msg/Log")
LOG_ALL: Final = Topic("/play_launch/log/all", "rcl_interfaces/msg/Log")
PARAMETERS: Final = Topic(
    "/play_launch/parameters", "play_launch_msgs/msg/NodeParameters", latched=True
)
"""`topic_recorder` writes it."""
PARAMETER_EVENTS: Final = Topic("/parameter_events", "rcl_interfaces/msg/ParameterEvent")
"""Of ROS itself."""
SYSTEM: Final = Topic("/play_launch/system", "play_launch_msgs/msg/SystemStats")

INPUTS: Final = Topic("/play_launch/inputs", "rcl_interfaces/msg/ParameterValue")
"""See `play_launch.recording.decisions`."""

ALL_TOPICS: Final = (COMPONENT_EVENTS, STATES, GRAPH, ACTIONS, OUTPUT, LOG, LOG_ALL)
"""Those that every recording has; others come with their first message."""


@cache
def stats_topic(kind: SubjectKind, key: str) -> Topic:
    """Give the topic for what a process uses, named after the thing it is the process of.

    A label is no name of a node, and repeats from container to container: it is put below that of
    its container, without what a topic cannot have. The metadata says exactly what it is about.
    """
    return Topic(f"{_place(kind, key)}/stats", PROCESS_STATS, about=(kind, key))


@cache
def group_topic(kind: SubjectKind, key: str) -> Topic:
    """Give the topic for what its control group uses, likewise."""
    return Topic(f"{_place(kind, key)}/cgroup", GROUP_STATS, about=(kind, key))


def _place(kind: SubjectKind, key: str) -> str:
    room, path = ("container" if kind is SubjectKind.CONTAINER else "node"), key
    if kind is SubjectKind.NODE:
        container, _, name = key.partition(":/")
        path = f"{container}/{name}" if "[" in name else name
    words = [_NOT_IN_A_NAME.sub("_", word.strip("[]")) for word in path.split("/") if word]
    words = [f"_{word}" if word[:1].isdigit() else word for word in words]
    return f"/play_launch/{room}/{'/'.join(words)}"


def message_definition(type_name: str, prefixes: tuple[Path, ...] | None = None) -> str:
    """Return the definition of ``package/msg/Name`` with everything it depends on.

    Raises :class:`SchemaNotFoundError` when a definition is not installed below ``prefixes``, or
    belongs to an action or a service. ROS from wheels is below Python's own prefix, and needs no
    ``AMENT_PREFIX_PATH``.
    """
    if "/msg/" not in type_name:
        why = "is that of an action or a service: readers of recordings refuse its name"
        raise SchemaNotFoundError(f"message definition {type_name} {why}")
    places = prefixes or (*ament_prefixes(os.environ), Path(sys.prefix))
    package, name = _split(type_name, "")
    seen = {(package, name)}
    waiting = deque(seen)
    parts: list[str] = []
    while waiting:
        package, name = waiting.popleft()
        text = _read(package, name, places)
        parts.append(text if not parts else f"{_SEPARATOR}\nMSG: {package}/{name}\n{text}")
        for used in _used_types(text, package):
            if used not in seen:
                seen.add(used)
                waiting.append(used)
    return "".join(part if part.endswith("\n") else part + "\n" for part in parts)


def _used_types(text: str, package: str) -> list[tuple[str, str]]:
    used: list[tuple[str, str]] = []
    for line in text.splitlines():
        match = _FIELD.match(line)
        if match and match["type"] not in _PRIMITIVES:
            used.append(_split(match["type"], package))
    return used


def _split(type_name: str, package: str) -> tuple[str, str]:
    """``package/msg/Name``, ``package/Name`` or ``Name`` in ``package`` -> (package, name)."""
    if type_name == "Header":
        return "std_msgs", "Header"
    first, _, _ = type_name.partition("/")
    return (package if first == type_name else first), type_name.rpartition("/")[2]


def _read(package: str, name: str, prefixes: tuple[Path, ...]) -> str:
    folders = [prefix / "share" / package / "msg" for prefix in prefixes]
    for folder in [DEFINITIONS] if package == "play_launch_msgs" else folders:
        try:
            return (folder / f"{name}.msg").read_text(encoding="utf-8")
        except (FileNotFoundError, NotADirectoryError):
            continue
    raise SchemaNotFoundError(
        f"message definition {package}/msg/{name} is not installed: no prefix in AMENT_PREFIX_PATH "
        "has it; source your ROS installation, or install play-launch-py again"
    )
