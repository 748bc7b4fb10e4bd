from __future__ import annotations

import pytest

from play_launch.cli.output import duration
from play_launch.cli.show.summary import (
    container_status,
    is_complete,
)
from play_launch.supervisor.events import ContainerState, NodeState, RunEvent
from tests.cli.scenes import SECOND, START, container, node, view


def status(*events: RunEvent, at: float = 0) -> str:
    return container_status(view(*events).containers["/c"], START + round(at * SECOND))


def test_a_container_says_what_it_waits_for_and_how_long() -> None:
    events: list[RunEvent] = [
        container("/c"),
        node("/c", 0, NodeState.LOADED),
        node("/c", 1, NodeState.LOADING, at=1),
    ]
    assert status(*events, at=2) == "loaded 1/2, waiting on /c/n1"
    assert status(*events, at=13) == "loaded 1/2, waiting on /c/n1 … 12 s"
    # A repeated report does not start the clock again.
    events.append(node("/c", 1, NodeState.LOADING, at=10, elapsed=9))
    assert status(*events, at=13) == "loaded 1/2, waiting on /c/n1 … 12 s"
    events.append(node("/c", 2, NodeState.PENDING, at=12))
    assert status(*events, at=13) == "loaded 1/3, waiting on /c/n1 and 1 more … 12 s"


def test_a_container_says_what_failed() -> None:
    events: list[RunEvent] = [
        container("/c"),
        node("/c", 0, NodeState.LOAD_FAILED),
        node("/c", 1, NodeState.LOADED),
    ]
    assert status(*events) == "loaded 1/2, failed: /c/n0"
    assert not is_complete(view(*events).containers["/c"])


@pytest.mark.parametrize(
    ("state", "expected"),
    [
        (ContainerState.STARTING, "starting: again in 1 s … 5.0 s"),
        (ContainerState.BACKOFF, "backoff: again in 1 s"),
        (ContainerState.GAVE_UP, "gave up: again in 1 s"),
        (ContainerState.STOPPING, "stopping: again in 1 s"),
        (ContainerState.STOPPED, "stopped: again in 1 s"),
    ],
)
def test_a_container_that_does_not_run_says_why(state: ContainerState, expected: str) -> None:
    assert status(container("/c", state, reason="again in 1 s"), at=5) == expected


@pytest.mark.parametrize(
    ("seconds", "expected"),
    [
        (0.04, "0.0 s"),
        (9.94, "9.9 s"),
        (9.96, "10 s"),
        (59.4, "59 s"),
        (59.6, "1 min 0 s"),
        (200, "3 min 20 s"),
        (7500, "2 h 5 min"),
    ],
)
def test_durations_are_for_people(seconds: float, expected: str) -> None:
    assert duration(round(seconds * SECOND)) == expected
