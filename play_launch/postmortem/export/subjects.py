"""What of a session a layout shows: with a hundred nodes, not everything fits into a plot."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

from play_launch.config.node_key import NodeKey
from play_launch.recording.topics import stats_topic
from play_launch.supervisor.events import (
    MemoryKind,
    NodeStateChanged,
    ProcessEvent,
    ProcessEventKind,
    ProcessSample,
    SubjectKind,
)
from play_launch.supervisor.view import FAILED_STATES

if TYPE_CHECKING:
    from play_launch.postmortem.session import PastSession

MOST: Final = 12
"""Nodes and processes in one plot."""


class Subject(NamedTuple):
    """A container, a node or a process that was measured."""

    kind: SubjectKind
    key: str

    @property
    def topic(self) -> str:
        """Where its samples are."""
        return stats_topic(self.kind, self.key).name

    @property
    def label(self) -> str:
        """Its name."""
        return NodeKey.parsed(self.key).name if self.kind is SubjectKind.NODE else self.key


class Subjects(NamedTuple):
    """What is shown."""

    containers: tuple[Subject, ...]
    others: tuple[Subject, ...]
    """Nodes and processes: those that failed, then those that used the most CPU time."""
    memory: tuple[Subject, ...]
    """Those of both that have memory of their own."""


NO_SUBJECT: Final = Subjects((), (), ())


def chosen(session: PastSession) -> Subjects:
    """Read a session and choose.

    Raises:
        NotARecordingError: At once, for another kind of file.
    """
    used: dict[Subject, float] = {}
    sharing: set[Subject] = set()
    failed: set[str] = set()
    for happened in session.events():
        match event := happened.event:
            case ProcessSample():
                subject = Subject(event.kind, event.key)
                used[subject] = event.cpu_seconds
                if event.memory_kind is MemoryKind.SHARED:
                    sharing.add(subject)
            case NodeStateChanged() if event.state in FAILED_STATES:
                failed.add(str(event.key))
            case ProcessEvent(kind=ProcessEventKind.EXITED) if event.signal or event.exit_code:
                failed.add(event.name)
            case _:
                pass
    order = sorted(used, key=lambda one: (one.key not in failed, -used[one], one.key))
    containers = tuple(one for one in order if one.kind is SubjectKind.CONTAINER)[:MOST]
    others = tuple(one for one in order if one.kind is not SubjectKind.CONTAINER)[:MOST]
    memory = tuple(one for one in (*containers, *others) if one not in sharing)
    return Subjects(containers, others, memory)
