"""What comes along with a word about a node."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final

from msgspec import Struct

from play_launch.core.events import ComponentEventKind
from play_launch.core.node_table import NodeInput
from play_launch.process.exit import Exit
from play_launch.process.machine import explained

if TYPE_CHECKING:
    from collections.abc import Sequence

    from play_launch.core.events import ComponentEvent
    from play_launch.core.questions import Asked
    from play_launch.wire.messages import NodeStatus


class Facts(Struct, frozen=True, kw_only=True):
    """What is known besides the word itself; 0 and empty where it is not."""

    attempt: int = 0
    unique_id: int = 0
    reason: str = ""
    pid: int = 0
    start_time: int = 0
    cpu_time_ns: int = 0
    signal: int = 0
    """What its process died of."""
    full_node_name: str = ""
    is_constructing: bool = False
    """Whether its constructor runs, and does not wait for its turn."""


NOTHING: Final = Facts()


INPUT_OF_EVENT: Final = {
    ComponentEventKind.LOADED: NodeInput.LOADED,
    ComponentEventKind.UNLOADED: NodeInput.UNLOADED,
    ComponentEventKind.LOAD_FAILED: NodeInput.LOAD_FAILED,
    ComponentEventKind.CRASHED: NodeInput.CRASHED,
    ComponentEventKind.LOADING: NodeInput.LOADING,
}
"""What an event of the container says about the node."""

_RUNTIME: Final = re.compile(r"\b(?:libc|libstdc\+\+|libgcc_s|libpthread|ld-linux[\w-]*)\.so\b")
"""Libraries in which a fault shows, but which seldom are to blame for it."""


def facts_of_event(event: ComponentEvent) -> Facts:
    """Take them from an event of the container; the reason of a crash says where it happened."""
    reason = event.error_message
    if event.kind is ComponentEventKind.CRASHED:
        ending = str(explained(Exit(code=event.exit_code, signal=event.signal)))
        reason = f"{ending}: {reason}" if reason else ending
        if event.backtrace:
            reason += f" at {blamed_frame(event.backtrace)}"
    return Facts(
        attempt=event.attempt,
        unique_id=event.unique_id,
        reason=reason,
        pid=event.pid,
        start_time=event.start_time,
        signal=event.signal,
        full_node_name=event.full_node_name,
    )


def blamed_frame(backtrace: Sequence[str]) -> str:
    """Choose the frame to show where there is room for one: abort() says less than its caller."""
    return next((frame for frame in backtrace if not _RUNTIME.search(frame)), backtrace[0])


def facts_of_status(asked: Asked, listed: NodeStatus | None) -> Facts:
    """Take them from the answer to a question; None: the container does not list the node."""
    if listed is None:
        reason = "the container does not know it"
        return Facts(attempt=asked.attempt, unique_id=asked.unique_id, reason=reason)
    elapsed, cpu = listed.elapsed_ns / 1e9, listed.cpu_time_ns / 1e9
    slow = f"its constructor runs for {elapsed:.1f} s in pid {listed.pid}, {cpu:.1f} s of it on CPU"
    is_constructing = listed.state == 0 and not listed.note
    waits = f"{listed.note} ({elapsed:.1f} s so far)" if listed.note else ""
    return Facts(
        attempt=listed.attempt,
        unique_id=listed.unique_id,
        reason=waits or (slow if is_constructing else ""),
        pid=listed.pid,
        start_time=listed.start_time,
        cpu_time_ns=listed.cpu_time_ns,
        full_node_name=listed.full_node_name,
        is_constructing=is_constructing,
    )
