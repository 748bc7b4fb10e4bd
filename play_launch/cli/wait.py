"""``play-launch wait``: until a system is up."""

from __future__ import annotations

import json
import time
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal

import typer

from play_launch import ExitCode
from play_launch.cli import options as cli_options
from play_launch.cli.connection import connected
from play_launch.cli.output import duration, fail, report, say
from play_launch.postmortem.diagnostics import ERROR, TOPIC, Diagnostics, reports_of

if TYPE_CHECKING:
    from diagnostic_msgs.msg import DiagnosticArray

    from play_launch.control.client import ControlClient
    from play_launch.ros.node_services import NodeServices

_SPARE: Final = 1.0
"""Seconds that the answer may be later than the limit."""
_LEAST: Final = 0.001
_ROUND: Final = 10.0
"""Seconds in the graph until the session is asked again."""
_CALL_LIMIT: Final = 2.0
_SETTLED: Final = 0.5
"""Seconds in which no further service is seen, until all are known."""
_UNSERVED: Final = 5.0
"""The same where a node is seen without any service: few have none."""
_REPORTS: Final = 2.5
"""Seconds in which each status is reported: mostly one is, each second."""
_LIFECYCLE: Final = "lifecycle_msgs/srv/GetState"
_GET_STATE: Final = "/get_state"


def wait(  # noqa: PLR0917 - options, by name
    names: cli_options.Names = None,
    condition: Annotated[
        Literal["loaded", "ready", "active"],
        typer.Option(
            "--for",
            help="loaded: containers and processes run, nodes are loaded. ready: nodes are in the "
            "ROS graph, and topics are as expected, as well. active: managed (lifecycle) nodes "
            "are active as well.",
        ),
    ] = "loaded",
    timeout: Annotated[
        float,
        cli_options.time("Limit, including the wait for a session.", "--timeout", default="60s"),
    ] = 60.0,
    diagnostics: Annotated[
        bool,
        typer.Option(
            "--diagnostics",
            help="With ready or active: no node reports ERROR or STALE on /diagnostics either.",
        ),
    ] = False,
    session: cli_options.Session = None,
    as_json: cli_options.Json = False,
) -> int:
    """Wait until a system is up; a failed node ends the wait at once.

    Without names it waits for everything that was not stopped by an operator. Exits with 4 after
    the timeout.
    """
    if diagnostics and condition == "loaded":
        fail("--diagnostics: only with --for ready or --for active")
    began = time.monotonic()
    wanted, deadline = names or [], began + timeout
    with connected(session, deadline=deadline) as client:
        up = _up(client, wanted, condition, deadline)
        missing: list[str] = []
        if condition != "loaded":
            up, missing = _wait_in_the_graph(
                client, wanted, condition, deadline, up, diagnostics=diagnostics
            )
            if not missing and not wanted:
                _up(client, wanted, "expected", deadline)
    seconds = time.monotonic() - began
    if as_json:
        values: dict[str, Any] = {
            "reached": not missing,
            "for": condition,
            "seconds": round(seconds, 3),
            "names": up,
            "missing": missing,
        }
        say(json.dumps(values))
    elif not missing:
        say(f"{len(up)} {condition} after {duration(round(seconds * 1e9))}")
    if missing:
        report(f"not {condition}: {', '.join(missing)}")
        return ExitCode.TIMEOUT
    return ExitCode.OK


def _up(client: ControlClient, names: list[str], condition: str, deadline: float) -> list[str]:
    """Wait for what the session knows of, and return the names of what is up."""
    left = max(deadline - time.monotonic(), _LEAST)
    # Nodes with autostart can fail on the way to active. The others are queried, see below.
    known = "loaded" if condition == "ready" else condition
    arguments = {"names": names, "timeout": left, "for": known}
    answer = client.ask("wait", arguments, limit=left + _SPARE)
    return [each["name"] for each in answer["results"]]


def _wait_in_the_graph(
    client: ControlClient,
    names: list[str],
    condition: str,
    deadline: float,
    up: list[str],
    *,
    diagnostics: bool,
) -> tuple[list[str], list[str]]:
    """Return what is up, and what of it is not as it should be in time.

    The session is asked again from time to time: meanwhile nodes crash, come and go.
    """
    from play_launch.cli.connection import enter_environment_of  # noqa: PLC0415 - slow

    enter_environment_of(client)
    from play_launch.ros.node_services import NodeServices  # noqa: PLC0415 - slow

    with NodeServices() as ros:
        managed = _Managed(ros)
        statuses = _Statuses(ros) if diagnostics else None
        while True:
            end = min(deadline, time.monotonic() + _ROUND)
            rows = [row for row in client.ask("ps") if row["name"] in up]
            # A process need not be a node, unless it is named; nor has every node a name.
            expected = {
                row["name"]
                for row in rows
                if (names or row["kind"] == "component") and "[" not in row["name"]
            }
            missing: list[str] = []
            if not ros.until(lambda: ros.nodes() >= expected, end):  # noqa: B023 - used at once
                missing = sorted(expected - ros.nodes())
            elif condition == "active":
                missing = _inactive(ros, managed, up, expected, end)
            if not missing and statuses is not None:
                missing = statuses.bad(end)
            if not missing or time.monotonic() >= deadline:
                return up, missing
            up = _up(client, names, condition, deadline)


class _Statuses:
    """What nodes report on ``/diagnostics``."""

    def __init__(self, ros: NodeServices) -> None:
        from diagnostic_msgs.msg import DiagnosticArray  # noqa: PLC0415 - slow

        self._ros = ros
        self._found = Diagnostics(None)
        self._heard_from = time.monotonic() + _REPORTS
        ros.subscribe(DiagnosticArray, TOPIC, self._take)

    def _take(self, array: DiagnosticArray) -> None:
        self._found.report(time.time_ns(), reports_of(array))

    def _bad(self) -> list[str]:
        return [
            f"{name} ({status.report['message'] or 'no message'})"
            for name, status in self._found.statuses.items()
            if status.level >= ERROR
        ]

    def bad(self, deadline: float) -> list[str]:
        """Return the statuses that are not well in time, with their messages."""
        if self._ros.until(
            lambda: time.monotonic() >= self._heard_from and not self._bad(), deadline
        ):
            return []
        return self._bad() or ["what nodes report on /diagnostics"]


class _Managed:
    """Tells managed nodes by their services, which may be seen later than the nodes."""

    def __init__(self, ros: NodeServices) -> None:
        self._ros = ros
        self._seen: dict[str, list[str]] = {}
        self._since = time.monotonic()

    def among(self, names: list[str], expected: set[str], deadline: float) -> list[str] | None:
        """Find the managed ones of these, of which some are expected; None: not known in time."""

        def is_settled() -> bool:
            found = {
                service: types
                for service, types in self._ros.services().items()
                if service.rpartition("/")[0] in names
            }
            if found != self._seen:
                self._seen, self._since = found, time.monotonic()
            # Nearly every node has some, those for its parameters.
            is_served = expected <= {service.rpartition("/")[0] for service in found}
            return time.monotonic() - self._since >= (_SETTLED if is_served else _UNSERVED)

        if not self._ros.until(is_settled, deadline):
            return None
        return [name for name in names if _LIFECYCLE in self._seen.get(f"{name}{_GET_STATE}", ())]


def _inactive(
    ros: NodeServices, managed: _Managed, up: list[str], expected: set[str], deadline: float
) -> list[str]:
    """Return the managed nodes that are not active in time."""
    from lifecycle_msgs.msg import State  # noqa: PLC0415 - slow
    from lifecycle_msgs.srv import GetState  # noqa: PLC0415

    from play_launch.ros.node_services import NodeServiceError  # noqa: PLC0415

    inactive = managed.among(up, expected, deadline)
    if inactive is None:
        return sorted(expected)
    while inactive:
        for name in tuple(inactive):
            left = deadline - time.monotonic()
            if left <= 0:
                return inactive
            limit = min(left, _CALL_LIMIT)
            try:
                answer = ros.call(name, "get_state", GetState, GetState.Request(), limit)
            except NodeServiceError:
                continue  # it may be busy with a transition
            if answer.current_state.id == State.PRIMARY_STATE_ACTIVE:
                inactive.remove(name)
            else:
                ros.until(lambda: False, min(deadline, time.monotonic() + 0.1))
    return []
