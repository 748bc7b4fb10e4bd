"""``play-launch diagnostics``: the states of all units on ``/diagnostics``, for other tools."""

from __future__ import annotations

import signal
import socket
import threading
import time
from typing import TYPE_CHECKING, Annotated, Any, Final

import msgspec

from play_launch import ExitCode
from play_launch.cli import options
from play_launch.cli.connection import connected, enter_environment_of, report_end
from play_launch.cli.output import note
from play_launch.control.messages import UnitRow
from play_launch.control.protocol import OperationError
from play_launch.control.units import Health, health, target_of
from play_launch.postmortem.diagnostics import ERROR, OK, OWN_PREFIX, STALE, WARN

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from diagnostic_msgs.msg import DiagnosticStatus

_START: Final = 60.0
"""Seconds until there is a session."""
_LEVELS: Final = {
    Health.FAILED: ERROR,
    Health.CHANGING: WARN,
    Health.UP: OK,
    Health.INACTIVE: OK,
}
_UNREACHABLE: Final = "unreachable"


def diagnostics(
    period: Annotated[float, options.time("Publish so often.", "--period", default="1s")] = 1.0,
    session: options.Session = None,
) -> int:
    """Publish the states of all units on /diagnostics, until Ctrl-C or the end of the session.

    One status for each unit and each topic of which something is expected, for rqt_robot_monitor,
    Foxglove and the like. As a process of the configuration it comes and goes with the system.
    """
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    with connected(session, deadline=time.monotonic() + _START) as client:
        enter_environment_of(client)
        from diagnostic_msgs.msg import DiagnosticArray  # noqa: PLC0415 - slow

        from play_launch.ros.node_services import NodeServices  # noqa: PLC0415 - slow

        note(f"publishing the states of {client.hello.name} on /diagnostics")
        with NodeServices() as ros:
            publish = ros.publisher(DiagnosticArray, "/diagnostics")
            while not stop.wait(period):
                try:
                    units = msgspec.convert(client.ask("ps"), list[UnitRow], strict=False)
                    topics = client.ask("expectations")
                except OperationError as error:
                    return report_end(client.hello, str(error))
                array = DiagnosticArray(status=[*map(_of_unit, units), *_of_topics(topics)])
                array.header.stamp = ros.now()
                publish(array)
    return ExitCode.OK


def _of_unit(row: UnitRow) -> DiagnosticStatus:
    level = STALE if row.state == _UNREACHABLE else _LEVELS[health(row)]
    message = f"{row.state}: {row.reason}" if row.reason else row.state
    values = {
        "pid": row.pid,
        "restarts": row.restarts,
        "crashes": row.crashes,
        "cpu_percent": row.cpu_percent,
        "memory_bytes": row.memory_bytes,
    }
    return _status(str(target_of(row)), row.machine or "", level, message, values)


def _of_topics(rows: list[dict[str, Any]]) -> Iterator[DiagnosticStatus]:
    for row in rows:
        if row["is_met"] is not None:
            level = OK if row["is_met"] else ERROR
            values = {key: row[key] for key in ("rate", "max_gap", "publishers", "breaks")}
            message = row["reason"] or "as expected"
            yield _status(f"topic {row['topic']}", row.get("machine", ""), level, message, values)


def _status(
    name: str, machine: str, level: int, message: str, values: Mapping[str, object]
) -> DiagnosticStatus:
    from diagnostic_msgs.msg import DiagnosticStatus, KeyValue  # noqa: PLC0415 - slow

    return DiagnosticStatus(
        level=bytes([level]),
        name=f"{OWN_PREFIX}{name}",
        message=message,
        hardware_id=machine or socket.gethostname(),
        values=[
            KeyValue(key=key, value=str(value))
            for key, value in values.items()
            if value is not None
        ],
    )
