"""The diagnostics of ROS in a recording: the levels of each status, and which fell silent."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any, Final

from msgspec import Struct, field

from play_launch.container.cdr.structure import CdrError, Layout
from play_launch.postmortem.events import UnreadableEventError

if TYPE_CHECKING:
    from diagnostic_msgs.msg import DiagnosticArray

    from play_launch.postmortem.bag_reader import Message
    from play_launch.postmortem.past_session import PastSession

TOPIC: Final = "/diagnostics"
TYPE: Final = "diagnostic_msgs/msg/DiagnosticArray"
DIAGNOSTIC_ARRAY: Final = Layout(
    "stamp:t frame_id:s status:DiagnosticStatus[]",
    DiagnosticStatus=Layout(
        "level:B name:s message:s hardware_id:s values:KeyValue[]",
        KeyValue=Layout("key:s value:s"),
    ),
)
LEVELS: Final = ("OK", "WARN", "ERROR", "STALE")
"""By their numbers in `diagnostic_msgs/msg/DiagnosticStatus`."""
OK, WARN, ERROR, STALE = range(4)
OWN_PREFIX: Final = "play_launch: "
"""Begins the names of the statuses that `play-launch diagnostics` publishes of units."""
_STALE_AFTER: Final = 30.0
"""Of a recording that does not say it."""
_LOOK: Final = 1_000_000_000
"""Nanoseconds from one look for silence to the next."""
_MOST_STATUSES: Final = 10_000
_MOST_CHANGES: Final = 1_000
"""Of one status; further ones are counted."""


class LevelChange(Struct, frozen=True):
    """A status has another level than before; its first level is a change, too."""

    status: str
    hardware: str
    at_ns: int
    """Log time."""
    level: int
    message: str
    is_silence: bool = False
    """It is STALE because nothing was reported for as long as the configuration allows."""

    def __str__(self) -> str:
        return f"{level_name(self.level)}{f': {self.message}' if self.message else ''}"

    @property
    def name(self) -> str:
        """The status with its hardware."""
        return f"{self.status} ({self.hardware})" if self.hardware else self.status


class DiagnosticStatus(Struct):
    """One status, by its name."""

    seen_ns: int = 0
    """Log time of its last report."""
    level: int = -1
    is_silent: bool = False
    """It is STALE for that."""
    report: dict[str, Any] = field(default_factory=dict)
    """The last one, as `DIAGNOSTIC_ARRAY` has it."""
    changes: list[LevelChange] = field(default_factory=list)
    further_changes: int = 0


class Diagnostics:
    """Takes the messages of `TYPE` one after the other; `statuses` is the result so far."""

    def __init__(self, session: PastSession | None) -> None:
        """Take what was recorded of a session; None: what is reported now."""
        self.statuses: dict[str, DiagnosticStatus] = {}
        """By name."""
        self._session = session
        self._look_ns = 0

    @cached_property
    def stale_ns(self) -> int:
        """Nanoseconds without a report after which a status is STALE, as the session had it."""
        try:
            resolved = self._session.resolved if self._session else {}
            return int(resolved["record"]["stale_after"] * 1e9)
        except (KeyError, ValueError, TypeError, OverflowError):
            return int(_STALE_AFTER * 1e9)

    def take(self, message: Message) -> list[LevelChange]:
        """Take a message; raises UnreadableEventError when it is not what it should be."""
        try:
            reports = DIAGNOSTIC_ARRAY.read(message.data)["status"]
        except (CdrError, ValueError) as error:
            reason = f"a message of {message.topic.name} cannot be read: {error}"
            raise UnreadableEventError(reason) from error
        return self.report(message.log_time, reports)

    def report(self, at_ns: int, reports: list[dict[str, Any]]) -> list[LevelChange]:
        """Take what was reported at that time, each as `DIAGNOSTIC_ARRAY` has it."""
        changes = self.fell_silent(at_ns)
        for report in reports:
            name = report["name"]
            if name.startswith(OWN_PREFIX):
                continue  # the states of units say the same
            status = self.statuses.get(name)
            if status is None:
                if len(self.statuses) >= _MOST_STATUSES:
                    continue
                status = self.statuses[name] = DiagnosticStatus()
            status.seen_ns, status.report = at_ns, report
            if report["level"] != status.level or status.is_silent:
                hardware, said = report["hardware_id"], report["message"]
                change = LevelChange(name, hardware, at_ns, report["level"], said)
                changes.append(_changed(status, change))
        return changes

    def fell_silent(self, now_ns: int, *, is_end: bool = False) -> list[LevelChange]:
        """Find what was not reported any more, at most once a second or at the end."""
        if not self.statuses or (now_ns < self._look_ns and not is_end):
            return []
        self._look_ns = now_ns + _LOOK
        silent = [
            (name, status)
            for name, status in self.statuses.items()
            if now_ns - status.seen_ns > self.stale_ns and not status.is_silent
        ]
        return [_changed(status, self._silence(name, status)) for name, status in silent]

    def _silence(self, name: str, status: DiagnosticStatus) -> LevelChange:
        at_ns, hardware = status.seen_ns + self.stale_ns, status.report["hardware_id"]
        said = f"it was not reported for {self.stale_ns / 1e9:g} s"
        return LevelChange(name, hardware, at_ns, STALE, said, is_silence=True)


def reports_of(array: DiagnosticArray) -> list[dict[str, Any]]:
    """Give the statuses of a message of rclpy as `DIAGNOSTIC_ARRAY` has them."""
    return [
        {
            "level": status.level[0],
            "name": status.name,
            "message": status.message,
            "hardware_id": status.hardware_id,
            "values": [{"key": each.key, "value": each.value} for each in status.values],
        }
        for status in array.status
    ]


def status_object(name: str, status: DiagnosticStatus) -> dict[str, Any]:
    """Give a status as plain values: its level, since when, and its last report."""
    latest = status.changes[-1]
    return {
        "name": name,
        "hardware_id": status.report["hardware_id"],
        "level": level_name(status.level),
        "message": latest.message if status.is_silent else status.report["message"],
        "since_ns": latest.at_ns,
        "seen_ns": status.seen_ns,
        "values": {each["key"]: each["value"] for each in status.report["values"]},
    }


def level_name(level: int) -> str:
    return LEVELS[level] if level < len(LEVELS) else f"level {level}"


def _changed(status: DiagnosticStatus, change: LevelChange) -> LevelChange:
    status.level, status.is_silent = change.level, change.is_silence
    if len(status.changes) < _MOST_CHANGES:
        status.changes.append(change)
    else:
        status.further_changes += 1
    return change
