"""What is declared and not there at the end, through the real command."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from tests.support.replay import Replay, replaying, run
from tests.support.ros import Probe
from tests.support.scenes import container, ending, node, written


@dataclass(frozen=True)
class Case:
    """What happens to a container named like the case.

    Attributes:
        kind: The container's.
        outcome: The event of a node or container that says that something is missing.
        other: The plugin of the other node.
        do: Takes the name and the events of the nodes when both are loaded.
    """

    kind: str
    outcome: tuple[str, str]
    other: str = "Listener"
    do: Callable[[str, dict[str, dict[str, Any]]], None] | None = None


def unload_the_talker(name: str, nodes: dict[str, dict[str, Any]]) -> None:
    with Probe() as probe:
        unique_id = nodes[f"/{name}/talker"]["unique_id"]
        assert probe.unload(unique_id, f"/{name}").success


def terminate_the_container(name: str, nodes: dict[str, dict[str, Any]]) -> None:
    os.kill(nodes[f"/{name}/talker"]["pid"], signal.SIGTERM)


CASES = {
    "unloaded_standard": Case("standard", ("node", "unloaded"), do=unload_the_talker),
    "unloaded_isolated": Case("isolated", ("node", "unloaded"), do=unload_the_talker),
    "terminated": Case("standard", ("container", "backoff"), do=terminate_the_container),
    "quit_isolated": Case("isolated", ("node", "unloaded"), "Quitter"),
    "quit_standard": Case("standard", ("container", "stopped"), "Quitter"),
}


def configuration(path: Path, name: str, case: Case, end: Path) -> Path:
    nodes = [
        node("talker", namespace=f"/{name}"),
        node("listener", case.other, namespace=f"/{name}"),
    ]
    return written(
        path,
        composable_node_loading={"restart": {"backoff": {"initial": "100 s", "maximum": "100 s"}}},
        containers=[container(name, *nodes, container_type=case.kind)],
        nodes=[ending(end)],
    )


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Replay]:
    """A run of the command for each case, side by side, until all have come to their outcome."""
    folder = tmp_path_factory.mktemp("missing")
    end = folder / "end"
    replays: dict[str, Replay] = {}
    with ExitStack() as stack:
        for name, case in CASES.items():
            config = configuration(folder / f"{name}.yaml", name, case, end)
            replays[name] = stack.enter_context(replaying(config, folder / name))
        for name, case in CASES.items():
            if case.do is not None:
                case.do(name, replays[name].read_until_up(f"/{name}/talker", f"/{name}/listener"))
            replays[name].read_until(
                # At the beginning containers are stopped without a reason.
                lambda event, to=case.outcome: (
                    (event["event"], event.get("state")) == to and event["reason"]
                ),
                f"{case.outcome}",
            )
        end.touch()
        for replay in replays.values():
            replay.read_all()
    return replays


def unloaded(replay: Replay, name: str) -> dict[str, Any]:
    return replay.told(event="node", node=name, state="unloaded")[0]


@pytest.mark.parametrize("name", CASES)
def test_the_exit_code_says_that_something_is_missing(runs: dict[str, Replay], name: str) -> None:
    replay = runs[name]
    assert replay.seen[-1]["exit_code"] == replay.process.returncode == 3
    assert f"/{name}" in run("explain", replay.bag, code=1).stdout


@pytest.mark.parametrize("name", ["unloaded_standard", "unloaded_isolated"])
def test_a_node_that_another_program_unloads(runs: dict[str, Replay], name: str) -> None:
    replay = runs[name]
    talker = f"/{name}/talker"
    assert unloaded(replay, talker)["reason"] == "not at the supervisor's request"
    (container,) = replay.seen[-1]["containers"]
    assert (container["loaded"], container["unloaded"]) == (1, [talker])


def test_a_container_that_another_program_ends_in_order(runs: dict[str, Replay]) -> None:
    replay = runs["terminated"]
    exited = replay.told(event="process", kind="exited")[0]
    assert (exited["exit_code"], exited["signal"]) == (0, 0)
    (container,) = replay.seen[-1]["containers"]
    assert container["state"] == "backoff"


def test_an_isolated_node_that_shuts_the_ros_context_down(runs: dict[str, Replay]) -> None:
    replay = runs["quit_isolated"]
    listener = "/quit_isolated/listener"
    assert "context" in unloaded(replay, listener)["reason"]
    (container,) = replay.seen[-1]["containers"]
    assert (container["loaded"], container["unloaded"]) == (1, [listener])


def test_a_node_that_shuts_the_ros_context_of_all_down(runs: dict[str, Replay]) -> None:
    replay, name = runs["quit_standard"], "quit_standard"
    assert len(replay.told(name=f"/{name}", kind="started")) == 1, "it was started again"
    reasons = [each["error_message"] for each in replay.told(kind="unloaded")]
    assert reasons
    listener = f"/{name}/listener"
    assert all(f"{listener} shut the ROS context down" in reason for reason in reasons)
    (container,) = replay.seen[-1]["containers"]
    assert container["state"] == "stopped"
    stops = replay.told(event="container", state="stopped")
    assert "a node shut its ROS context down" in stops[-1]["reason"]
    (session,) = replay.told(event="session")
    explained = run("explain", session["folder"]).stdout
    assert f"/{name} died" in explained
    assert "that is, a component called rclcpp::shutdown()" in explained
    assert "Fix: set container_type: isolated" in explained
