"""In which phase a service is, and which words the service manager hears of it. Pure."""

from __future__ import annotations

from enum import StrEnum, auto
from typing import TYPE_CHECKING, Final

from play_launch.supervisor.events import ContainerState

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from play_launch.supervisor.view import SystemView

_MOST_NAMED: Final = 3
_LONGEST: Final = 400
"""Characters of a line of status."""


class Phase(StrEnum):
    """What the service manager believes."""

    STARTING = auto()
    READY = auto()
    RELOADING = auto()
    STOPPING = auto()


ANNOUNCED: Final[Mapping[Phase, str]] = {
    Phase.READY: "READY=1",
    Phase.RELOADING: "RELOADING=1",
    Phase.STOPPING: "STOPPING=1",
}
"""What is sent when a phase begins."""
EXTENDED: Final = frozenset({Phase.STARTING, Phase.RELOADING})
"""Phases that may last as long as the supervisor is well; the manager's time limit is extended."""


def following(phase: Phase, *, is_up: bool, changes: bool, ends: bool) -> Phase:
    """Give the phase after this one, the same when nothing follows.

    Each is announced, so a system that is over at once was ready before.

    Args:
        phase: Of which the manager knows.
        is_up: Whether everything that is declared was up, or failed for good, as the end began.
        changes: Whether another configuration is being applied.
        ends: Whether the end was asked for.
    """
    if phase is Phase.STOPPING or (phase is Phase.STARTING and not is_up and not ends):
        return phase
    if phase is Phase.STARTING and is_up:
        return Phase.READY
    if ends:
        return Phase.STOPPING
    return Phase.RELOADING if changes else Phase.READY


def status(
    phase: Phase,
    view: SystemView,
    pending: Sequence[str],
    *,
    reason: str = "",
    health_problem: str = "",
) -> str:
    """Describe the state of the system in one line, for `systemctl status`.

    Args:
        phase: The phase.
        view: The system.
        pending: Units that have neither been up nor failed for good.
        reason: Why the system stops.
        health_problem: Health problem of the supervisor itself; empty if there is none.
    """
    words = [_beginning(phase, pending, reason), _size(view)]
    if failed := _failed(view):
        words.append(f"failed: {_named(failed)}")
    if health_problem:
        words.insert(0, f"health problem: {health_problem}")
    text = "; ".join(word for word in words if word)
    return "".join(each if each.isprintable() else " " for each in text)[:_LONGEST]


def _beginning(phase: Phase, pending: Sequence[str], reason: str) -> str:
    match phase:
        case Phase.STARTING:
            return f"starting, pending: {_named(pending)}" if pending else "starting"
        case Phase.READY:
            return ""
        case Phase.RELOADING:
            return "applying another configuration"
        case Phase.STOPPING:
            return f"stopping: {reason}" if reason else "stopping"


def _size(view: SystemView) -> str:
    """Count what is there: ``7 of 8 nodes loaded, 3 of 3 containers and 2 processes run``."""
    words = []
    if view.total:
        words.append(f"{view.loaded} of {view.total} nodes loaded")
    running = []
    if view.containers:
        up = sum(each.state is ContainerState.RUNNING for each in view.containers.values())
        running.append(f"{up} of {len(view.containers)} containers")
    if view.processes:
        up = sum(each.pid != 0 for each in view.processes.values())
        running.append(f"{up} of {len(view.processes)} processes")
    if running:
        words.append(f"{' and '.join(running)} running")
    return ", ".join(words)


def _failed(view: SystemView) -> list[str]:
    expected = view.expected
    return [
        *expected.gave_up,
        *(each.node for each in expected.failed if each.container not in expected.gave_up),
        *(each.name for each in expected.failed_processes),
        *(each.unit.rpartition(":")[2] for each in view.failed_managed),
    ]


def _named(names: Sequence[str]) -> str:
    named = ", ".join(names[:_MOST_NAMED])
    return f"{named} and {len(names) - _MOST_NAMED} more" if len(names) > _MOST_NAMED else named
