"""What comes along with a word about a node."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from play_launch.core.questions import Asked
    from play_launch.native.messages import NodeStatus


@dataclass(frozen=True, slots=True, kw_only=True)
class Facts:
    """What is known besides the word itself; 0 and empty where it is not."""

    attempt: int = 0
    unique_id: int = 0
    reason: str = ""
    pid: int = 0
    start_time: int = 0
    cpu_time_ns: int = 0
    full_node_name: str = ""


NOTHING: Final = Facts()


def facts_of_status(asked: Asked, listed: NodeStatus | None) -> Facts:
    """Take them from the answer to a question; None: the container does not list the node."""
    if listed is None:
        reason = "the container does not know it"
        return Facts(attempt=asked.attempt, unique_id=asked.unique_id, reason=reason)
    elapsed, cpu = listed.elapsed_ns / 1e9, listed.cpu_time_ns / 1e9
    slow = f"its constructor runs for {elapsed:.1f} s in pid {listed.pid}, {cpu:.1f} s of it on CPU"
    return Facts(
        attempt=listed.attempt,
        unique_id=listed.unique_id,
        reason=slow if listed.state == 0 else "",
        pid=listed.pid,
        start_time=listed.start_time,
        cpu_time_ns=listed.cpu_time_ns,
        full_node_name=listed.full_node_name,
    )
