"""``play-launch diagnostics``: the states of all units on ``/diagnostics``, for other tools."""

from __future__ import annotations

import json
import signal
import socket
import sys
import threading
import time
from typing import TYPE_CHECKING, Annotated, Any, Final

import msgspec
import typer

from play_launch import ExitCode
from play_launch.cli import options
from play_launch.cli.connection import connected, enter_environment_of, report_end
from play_launch.cli.output import clock, fail, note, printable
from play_launch.control.messages import UnitRow
from play_launch.control.protocol import OperationError
from play_launch.control.units import Health, health, target_of
from play_launch.postmortem.diagnostics import (
    ERROR,
    OK,
    OWN_PREFIX,
    STALE,
    TOPIC,
    WARN,
    Diagnostics,
    reports_of,
    status_object,
)

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

    from play_launch.control.client import ControlClient
    from play_launch.postmortem.diagnostics import LevelChange
    from play_launch.ros.node_services import NodeServices

_START: Final = 60.0
"""Seconds until there is a session."""
_ASK: Final = 1.0
"""Seconds between two looks whether the session is there."""
_LEVELS: Final = {
    Health.FAILED: ERROR,
    Health.CHANGING: WARN,
    Health.UP: OK,
    Health.INACTIVE: OK,
}
_UNREACHABLE: Final = "unreachable"


def diagnostics(
    period: Annotated[float, options.time("Publish so often.", "--period", default="1s")] = 1.0,
    listen: Annotated[
        bool, typer.Option("--listen", help="Print what nodes report there instead.")
    ] = False,
    session: options.Session = None,
    as_json: options.Json = False,
) -> int:
    """Publish the states of all units on /diagnostics, until Ctrl-C or the end of the session.

    One status for each unit and each topic of which something is expected, for rqt_robot_monitor,
    Foxglove and the like. As a process of the configuration it comes and goes with the system.

    With --listen, print each status that a node reports, and each change of its level; STALE is
    what was not reported for 30 s. With --json, an object a line for each change of any kind.
    """
    if as_json and not listen:
        fail("--json: only with --listen")
    with connected(session, deadline=time.monotonic() + _START) as client:
        stop = threading.Event()
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: stop.set())
        enter_environment_of(client)
        from diagnostic_msgs.msg import DiagnosticArray  # noqa: PLC0415 - slow

        from play_launch.ros.node_services import NodeServices  # noqa: PLC0415 - slow

        with NodeServices() as ros:
            if listen:
                return _listen(ros, client, stop, as_json=as_json)
            note(f"publishing the states of {client.hello.name} on /diagnostics")
            publish = ros.publisher(DiagnosticArray, TOPIC)
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


def _listen(
    ros: NodeServices, client: ControlClient, stop: threading.Event, *, as_json: bool
) -> int:
    from diagnostic_msgs.msg import DiagnosticArray  # noqa: PLC0415 - slow

    found, told = Diagnostics(None), dict[str, object]()

    def lines(changes: list[LevelChange], names: Iterable[str]) -> Iterator[str]:
        if not as_json:
            yield from (printable(f"{clock(each.at_ns)} [{each.name}] {each}") for each in changes)
            return
        for name in dict.fromkeys([*(each.status for each in changes), *names]):
            status = found.statuses.get(name)
            if status is None:
                continue
            now = status_object(name, status)
            if (values := now | {"seen_ns": 0}) != told.get(name):
                told[name] = values
                yield json.dumps(now)

    def tell(changes: list[LevelChange], names: Iterable[str]) -> None:
        sys.stdout.writelines(f"{line}\n" for line in lines(changes, names))
        sys.stdout.flush()

    def take(array: DiagnosticArray) -> None:
        reports = reports_of(array)
        tell(found.report(time.time_ns(), reports), (each["name"] for each in reports))

    ros.subscribe(DiagnosticArray, TOPIC, take)
    while not stop.is_set():
        ros.until(stop.is_set, time.monotonic() + _ASK)
        tell(found.fell_silent(time.time_ns()), ())
        try:
            client.ask("system")
        except OperationError as error:
            return report_end(client.hello, str(error))
    return ExitCode.OK


def cells(status: dict[str, Any]) -> tuple[str, ...]:
    """Give the texts of a status that is printed as JSON: name, level with message, values."""
    hardware = f" ({status['hardware_id']})" if status["hardware_id"] else ""
    said = f"{status['level']}: {status['message']}".removesuffix(": ")
    values = ", ".join(f"{name}: {value}" for name, value in status["values"].items())
    return f"{status['name']}{hardware}", said, values


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
