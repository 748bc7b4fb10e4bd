"""The diagnostics of ROS in a recording: when a status was at an error, and which fell silent."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from msgspec import Struct, field

from play_launch.container.cdr.layout import CdrError, Layout
from play_launch.postmortem.events import UnreadableEventError

if TYPE_CHECKING:
    from play_launch.postmortem.bag_reader import Message

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
_MOST_STATUSES: Final = 10_000
_MOST_CHANGES: Final = 1_000
"""Of one status; further ones are counted."""


class LevelChange(Struct, frozen=True):
    """A status has another level than before."""

    at_ns: int
    """Log time."""
    level: int
    message: str


class Status(Struct):
    """One status, by its name."""

    seen_ns: int = 0
    """Log time of its last report."""
    level: int = -1
    hardware: str = ""
    changes: list[LevelChange] = field(default_factory=list)
    """Its first level is one, too."""
    further_changes: int = 0


class Diagnostics:
    """Takes the messages of `TYPE` one after the other; `statuses` is the result so far."""

    def __init__(self) -> None:
        self.statuses: dict[str, Status] = {}
        """By name."""

    def take(self, message: Message) -> None:
        """Take a message; raises UnreadableEventError when it is not what it should be."""
        try:
            reports = DIAGNOSTIC_ARRAY.read(message.data)["status"]
        except (CdrError, ValueError) as error:
            reason = f"a message of {message.topic.name} cannot be read: {error}"
            raise UnreadableEventError(reason) from error
        at_ns = message.log_time
        for report in reports:
            if report["name"].startswith(OWN_PREFIX):
                continue  # the states of units say the same
            status = self.statuses.get(report["name"])
            if status is None:
                if len(self.statuses) >= _MOST_STATUSES:
                    continue
                status = self.statuses[report["name"]] = Status(hardware=report["hardware_id"])
            status.seen_ns = at_ns
            if report["level"] == status.level:
                continue
            status.level = report["level"]
            if len(status.changes) < _MOST_CHANGES:
                status.changes.append(LevelChange(at_ns, status.level, report["message"]))
            else:
                status.further_changes += 1
