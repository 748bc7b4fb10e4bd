"""What the daemon reports about itself: the answer of ``system.play_launch_status``, as JSON."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field

VERSION = 1
"""Of this format; a field may be added without a change of it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DaemonStatus:
    """The daemon's state at one moment."""

    daemon: str = "play_launch"
    version: int = VERSION
    pid: int
    domain: int
    rmw: str
    """The middleware's identifier, such as ``rmw_fastrtps_cpp``."""
    node: str
    """Name of the node that looks at the graph."""
    age: float
    """Seconds since the daemon started."""
    warm: bool
    """Whether it answers about the graph; before, such requests wait."""
    settled: bool
    """Whether nothing changed for half a second and no participant is known to be missing."""
    generation: int
    """Grows with every change of the graph."""
    unchanged_for: float
    """Seconds since the last change."""
    changes_per_second: float
    """Over the last ten seconds. Changes within 50 ms count as one."""
    nodes: int
    """Nodes in the graph, without the daemon's own."""
    participants: int
    """DDS participants that the daemon has met, itself too; 0 where that cannot be seen."""
    participants_here: int
    """DDS participants of the domain on this machine, by the kernel's table of sockets."""
    replacements: int
    """How often the node was replaced because the network's addresses changed."""
    requests: int
    cached_replies: int
    """Requests that were answered without asking the graph again."""
    connections: int
    resets: int
    """Connections that were reset for their deadline, or because there were too many."""
    idle_timeout: float
    """Seconds without a request after which the daemon ends; 0 for never."""
    transports: str
    """Value of FASTDDS_BUILTIN_TRANSPORTS in the daemon, empty when it is not set."""
    transports_reason: str
    """Why; empty with another middleware than Fast DDS, where the variable means nothing."""
    settings: dict[str, str] = field(default_factory=dict)
    """The settings that decide whom it meets, by environment variable."""

    def to_json(self) -> str:
        """Return it as one JSON object."""
        return json.dumps(asdict(self), ensure_ascii=False)
