"""Recordings of the version that wrote no codes: causes and sequels are read from its sentences."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final, NamedTuple

from msgspec.structs import replace

from play_launch.supervisor.events import (
    NodeState,
    NodeStateChanged,
    ProcessEvent,
    ProcessEventKind,
    RecordingInterrupted,
)
from play_launch.supervisor.outcome import ENDING_SIGNALS, Cause, Sequel

if TYPE_CHECKING:
    from collections.abc import Iterator

    from play_launch.supervisor.events import ActionEvent, ComponentEvent, LogRecord

_RECORDER: Final = "play_launch.recording.recorder"
_INTERRUPTED: Final = "the recording is interrupted: "
_RESUMED: Final = re.compile(r"(?:the recording goes on|recording resumed) after ([0-9.]+) s[;,] ")
_NOTHING_LOST: Final = frozenset({"nothing is lost", "no data lost"})
_KILLED: Final = "killed: "
_FROZEN: Final = "it is frozen"
_SIGKILL: Final = 9
_DISMISSING: Final = frozenset({"stop", "unload"})
_RECALLING: Final = frozenset({"start", "restart", "load", "reload", "apply"})
_STOP_TIMEOUT: Final = re.compile(r"SIG[A-Z]+ \(it did not leave in time after the signal\)")
_PROCESS: Final = re.compile(r"\bprocess (\d+)\b")
_DELAY: Final = re.compile(r"\bin ([0-9.]+) s\b")


class _Words(NamedTuple):
    begin: str
    sequel: Sequel


_SEQUELS: Final = (
    _Words("it is loaded again", Sequel.RELOAD),
    _Words("it stays away", Sequel.NONE),
    _Words("everything is stopped", Sequel.SHUTDOWN),
)


class Version1:
    """Gives the events of such a recording their codes."""

    def __init__(self) -> None:
        self.is_over = False
        """Whether an event had codes: the recording is of a later version."""
        self._interruptions: list[RecordingInterrupted] = []
        self._deaths: dict[int, str] = {}
        """Keys of nodes that failed, by the pids of their processes."""

    def node(
        self, event: NodeStateChanged, report: ComponentEvent | None, *, is_stopping: bool
    ) -> NodeStateChanged:
        """Give a change of a node its codes; ``is_stopping`` is that of its container."""
        if event.state not in {NodeState.CRASHED, NodeState.LOAD_FAILED}:
            return replace(event, cause=Cause.NONE)
        if event.pid:
            self._deaths[event.pid] = str(event.key)
        said = report.error_message if report is not None else ""
        reason, sequel = _split(event.reason, said)
        is_late = is_stopping and report is not None and report.signal == _SIGKILL
        is_late = is_late or bool(_STOP_TIMEOUT.match(said or event.reason))
        delay = _DELAY.search(sequel)
        return replace(
            event,
            reason=reason,
            cause=Cause.STOP_TIMEOUT if is_late else Cause.SIGNAL,
            sequel=next((s for begin, s in _SEQUELS if sequel.startswith(begin)), Sequel.NONE),
            delay_ns=_nanoseconds(delay[1]) if delay else 0,
        )

    def process(self, event: ProcessEvent, *, is_stopping: bool) -> ProcessEvent:
        """Give a step of a process its codes."""
        cause, sequel, delay_ns, culprit = Cause.NONE, Sequel.NONE, 0, ""
        match event.kind:
            case ProcessEventKind.STOPPING if event.message.startswith(_KILLED):
                pids = reversed(_PROCESS.findall(event.message))
                culprit = next((key for p in pids if (key := self._deaths.get(int(p)))), "")
                is_frozen = event.message.startswith(_KILLED + _FROZEN)
                cause = Cause.FROZEN if is_frozen else Cause.CHANNEL_FAILED
                cause = Cause.NODE_LEFT_LOCK if culprit else cause
            case ProcessEventKind.STOPPING:
                cause = Cause.STOPPED
            case ProcessEventKind.EXITED if event.signal or event.exit_code:
                cause = Cause.SIGNAL if event.signal else Cause.EXIT_STATUS
                if is_stopping and event.signal == _SIGKILL:
                    cause = Cause.STOP_TIMEOUT
                elif is_stopping and event.signal in ENDING_SIGNALS:
                    cause = Cause.STOPPED
            case ProcessEventKind.RESTARTING:
                sequel = Sequel.RESTART
                delay = _DELAY.search(event.message)
                delay_ns = _nanoseconds(delay[1]) if delay else 0
        return replace(event, cause=cause, sequel=sequel, delay_ns=delay_ns, culprit=culprit)

    def log(self, record: LogRecord) -> None:
        """Note an interruption of the recording."""
        if record.name != _RECORDER:
            return
        if record.message.startswith(_INTERRUPTED):
            reason = record.message.removeprefix(_INTERRUPTED)
            self._interruptions.append(
                RecordingInterrupted(stamp_ns=record.stamp_ns, reason=reason, lasted_ns=0)
            )
        elif self._interruptions and (resumed := _RESUMED.match(record.message)):
            lost = record.message[resumed.end() :]
            self._interruptions[-1] = replace(
                self._interruptions[-1],
                lasted_ns=_nanoseconds(resumed[1]),
                lost="" if lost in _NOTHING_LOST else lost,
            )

    def dismissals(self, event: ActionEvent) -> Iterator[tuple[str, bool]]:
        """Give the units that the request of an operator dismissed, or recalled."""
        is_dismissed = event.action in _DISMISSING
        if not self.is_over and (is_dismissed or event.action in _RECALLING):
            yield from ((unit, is_dismissed) for unit in event.targets)

    def interruptions(self) -> Iterator[RecordingInterrupted]:
        """Give those that no event stands for."""
        return iter(() if self.is_over else self._interruptions)


def _nanoseconds(seconds: str) -> int:
    try:
        return round(float(seconds) * 1e9)
    except ValueError:
        return 0


def _split(reason: str, said: str) -> tuple[str, str]:
    """Divide the reason of an end into the cause, which may be a program's text, and the rest.

    ``said`` is the cause as the container reported it, if it did.
    """
    if said and reason.startswith(said):
        return said, reason.removeprefix(said).removeprefix("; ")
    cause, _, sequel = reason.rpartition("; ")
    if sequel.startswith(tuple(begin for begin, _ in _SEQUELS)):
        return cause, sequel
    return reason, ""
