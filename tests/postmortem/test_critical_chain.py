"""What the last node waited for, and what one waits for while a system comes up."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from play_launch.postmortem.critical_chain import critical_chain
from play_launch.supervisor.events import ContainerState, ManagedState, NodeState, ProcessEventKind
from tests.postmortem.scenes import Scene, ns

RULES = {
    "/robot": [("exited", "/setup")],
    "/robot:/planner": [("loaded", "/maps:/map"), ("started", "/maps")],
    "/maps": [("log", "/driver")],
    "/maps:/map": [("active", "/store:/files")],
}


def chain(tmp_path: Path, *, at: float) -> list[str]:
    """What `/planner` waits for so many seconds after the start."""
    scene = Scene()
    scene.resolved = {
        "start_rules": {
            key: {
                "dependencies": [{"condition": condition, "unit": unit} for condition, unit in rule]
            }
            for key, rule in RULES.items()
        }
    }
    happened: list[tuple[float, Callable[[float], None]]] = [
        (0, lambda at: scene.process(at, ProcessEventKind.STARTED, "/setup", pid=1)),
        (0, lambda at: scene.process(at, ProcessEventKind.STARTED, "/driver", pid=2)),
        (0, lambda at: scene.container(at, ContainerState.STARTING, "/store")),
        (1, lambda at: scene.container(at, ContainerState.RUNNING, "/store")),
        (1, lambda at: scene.node(at, "/files", NodeState.REQUESTED, container="/store")),
        (3, lambda at: scene.node(at, "/files", NodeState.LOADED, container="/store")),
        (4, lambda at: scene.process(at, ProcessEventKind.EXITED, "/setup", pid=1)),
        (4, lambda at: scene.container(at, ContainerState.STARTING, "/robot")),
        (5, lambda at: scene.container(at, ContainerState.RUNNING, "/robot")),
        (6, lambda at: scene.process(at, ProcessEventKind.STARTED, "/maps", pid=3)),
        (7, lambda at: scene.container(at, ContainerState.RUNNING, "/maps")),
        (9, lambda at: scene.managed(at, "/store:/files", ManagedState.ACTIVE)),
        (9, lambda at: scene.node(at, "/map", NodeState.REQUESTED, container="/maps")),
        (9, lambda at: scene.node(at, "/map", NodeState.LOADING, container="/maps")),
        (14, lambda at: scene.node(at, "/map", NodeState.LOADED, container="/maps")),
        (14, lambda at: scene.node(at, "/planner", NodeState.REQUESTED, container="/robot")),
        (15, lambda at: scene.node(at, "/planner", NodeState.LOADED, container="/robot")),
    ]
    scene.node(0, "/planner", NodeState.PENDING, container="/robot")
    scene.node(0, "/map", NodeState.PENDING, container="/maps")
    scene.container(0, ContainerState.STARTING, "/maps", reason="waits for a line of /driver")
    for when, happens in happened:
        if when <= at:
            happens(when)
    timeline = scene.story(tmp_path).timeline
    planner = next(unit for unit in timeline.units if unit.name == "/planner")
    return [link.text(ns(0)) for link in critical_chain(timeline, planner)]


def test_what_the_last_node_waited_for(tmp_path: Path) -> None:
    assert chain(tmp_path, at=15) == [
        "/planner, loaded after 15 s: it was loading for 1.0 s",
        "/map, loaded after 14 s: its constructor ran for 5.0 s",
        "/files, active after 9.0 s: it was loading for 2.0 s, it was being activated for 6.0 s",
        "/store, started after 1.0 s: it was starting for 1.0 s",
    ]


@pytest.mark.parametrize(
    ("at", "expected"),
    [
        (
            3,
            [
                "/planner, not loaded yet",
                "/robot, not started yet",
                "/setup, still running: it ran for 3.0 s",
            ],
        ),
        (
            5,
            [
                "/planner, not loaded yet",
                "/map, not loaded yet",
                "/maps, not started yet",
                "/driver, has not written the line: it ran for 5.0 s",
            ],
        ),
    ],
)
def test_what_a_node_is_waiting_for(tmp_path: Path, at: float, expected: list[str]) -> None:
    assert chain(tmp_path, at=at) == expected


def test_what_is_loaded_one_after_the_other(tmp_path: Path) -> None:
    scene = Scene()
    scene.container(0, ContainerState.STARTING)
    scene.container(1, ContainerState.RUNNING)
    scene.node(1, "/one", NodeState.REQUESTED)
    scene.node(1, "/two", NodeState.REQUESTED)
    scene.node(1, "/one", NodeState.LOADING)
    scene.node(4, "/one", NodeState.LOADED)
    scene.node(4, "/two", NodeState.LOADING)
    scene.node(6, "/two", NodeState.LOADED)
    timeline = scene.story(tmp_path).timeline
    found = critical_chain(timeline, next(unit for unit in timeline.units if unit.name == "/two"))
    assert [link.text(ns(0)) for link in found] == [
        "/two, loaded after 6.0 s: its constructor ran for 2.0 s",
        "/one, loaded after 4.0 s: its constructor ran for 3.0 s",
        "/box, started after 1.0 s: it was starting for 1.0 s",
    ]
