"""``play-launch wait``: until a system is up."""

from __future__ import annotations

import json
import sys
import time
from typing import TYPE_CHECKING, Any, Final

from play_launch.cli.operate import NOT_IN_TIME, OK, add_names, seconds

if TYPE_CHECKING:
    from argparse import ArgumentParser, Namespace

    from play_launch.control.client import ControlClient
    from play_launch.ros.node_services import NodeServices

LOADED: Final = "loaded"
READY: Final = "ready"
ACTIVE: Final = "active"
_USUAL_LIMIT: Final = 60.0
_SPARE: Final = 5.0
_CALL_LIMIT: Final = 2.0
_SETTLED: Final = 0.5
"""Seconds in which no further managed node is seen, until all of them are known."""
_LIFECYCLE: Final = "lifecycle_msgs/srv/GetState"
_GET_STATE: Final = "/get_state"


def add_arguments(parser: ArgumentParser, verb: str) -> None:  # noqa: ARG001 - as for all verbs
    """Declare what it takes."""
    add_names(parser, "only for these; by default for all but what a person stopped", optional=True)
    parser.add_argument(
        "--for",
        dest="condition",
        choices=(LOADED, READY, ACTIVE),
        default=LOADED,
        help="loaded: containers and processes run, nodes are loaded (the default); ready: and the "
        "nodes are in the ROS graph; active: and managed (lifecycle) nodes are active",
    )
    parser.add_argument(
        "--timeout",
        type=seconds,
        default=_USUAL_LIMIT,
        metavar="S",
        help=f"seconds, for a session to begin as well ({_USUAL_LIMIT:g})",
    )


def run(client: ControlClient, options: Namespace) -> int:
    """Wait; a failure ends it at once."""
    began = time.monotonic()
    deadline = began + options.timeout
    arguments = {"names": options.names, "timeout": options.timeout}
    if options.condition == ACTIVE:
        # Those that are brought there; they can fail. The others are asked, see below.
        arguments["for"] = ACTIVE
    answer = client.ask("wait", arguments, limit=options.timeout + _SPARE)
    up = [each["name"] for each in answer["results"]]
    waits_for: list[str] = []
    if options.condition != LOADED:
        waits_for = _wait_in_the_graph(client, options, up, deadline)
    seconds = time.monotonic() - began
    if options.json:
        values: dict[str, Any] = {
            "reached": not waits_for,
            "for": options.condition,
            "seconds": round(seconds, 3),
            "names": up,
            "missing": waits_for,
        }
        sys.stdout.write(f"{json.dumps(values)}\n")
    elif not waits_for:
        sys.stdout.write(f"{len(up)} {options.condition} after {seconds:.1f} s\n")
    if waits_for:
        sys.stderr.write(f"error: not {options.condition}: {', '.join(waits_for)}\n")
        return NOT_IN_TIME
    return OK


def _wait_in_the_graph(
    client: ControlClient, options: Namespace, up: list[str], deadline: float
) -> list[str]:
    """Return those that are not as they should be in time."""
    from play_launch.cli.session_environment import enter_environment_of  # noqa: PLC0415 - slow

    rows = client.ask("ps", {"names": up} if up else None)
    # A process need not be a node, unless somebody says so; nor has every node a name.
    expected = {
        row["name"]
        for row in rows
        if (options.names or row["kind"] == "component") and "[" not in row["name"]
    }
    enter_environment_of(client)
    from play_launch.ros.node_services import NodeServices  # noqa: PLC0415 - slow

    with NodeServices() as ros:
        is_there = ros.until(lambda: ros.nodes() >= expected, deadline)
        missing = [] if is_there else sorted(expected - ros.nodes())
        if missing or options.condition == READY:
            return missing
        return _wait_until_active(ros, up, deadline)


def _managed(ros: NodeServices, up: list[str], deadline: float) -> list[str]:
    """Find the managed ones by their services, which may be seen later than the nodes."""
    found: set[str] = set()
    since = time.monotonic()

    def has_settled() -> bool:
        nonlocal found, since
        services, now = ros.services(_LIFECYCLE), time.monotonic()
        if services != found:
            found, since = services, now
        return now - since >= _SETTLED

    ros.until(has_settled, deadline)
    return [name for name in up if f"{name}{_GET_STATE}" in found]


def _wait_until_active(ros: NodeServices, up: list[str], deadline: float) -> list[str]:
    from lifecycle_msgs.msg import State  # noqa: PLC0415 - slow
    from lifecycle_msgs.srv import GetState  # noqa: PLC0415

    from play_launch.ros.node_services import NodeServiceError  # noqa: PLC0415

    inactive = _managed(ros, up, deadline)
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
