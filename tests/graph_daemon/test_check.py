"""``play-launch graph check``, about real nodes."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Iterator
from typing import Any

import pytest

from play_launch.graph_daemon.contract import DaemonAddress
from tests.graph_daemon.broken import PAIRS
from tests.graph_daemon.conftest import system
from tests.support.replay import COMMAND


@pytest.fixture(scope="module")
def broken(daemon: DaemonAddress) -> Iterator[None]:
    """A system in which little connects."""
    with system("broken"):
        yield


def check(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [str(COMMAND), "graph", "check", "--wait", "60s", *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def problems(broken: None) -> dict[str, dict[str, Any]]:
    """What is found, by name."""
    found = check("--json")
    assert found.returncode == 1, found.stderr
    report = json.loads(found.stdout)
    assert report["quiet"]
    assert report["nodes"] == 3
    return {each["name"]: each for each in report["problems"]}


def test_what_connects_is_not_listed(problems: dict[str, dict[str, Any]]) -> None:
    kinds = {name: each["kind"] for name, each in problems.items()}
    assert kinds == {
        **dict.fromkeys((f"/qos/{policy}" for policy in PAIRS), "incompatible_qos"),
        "/two/types": "incompatible_type",
        "/points": "misnamed_topic",
        "/camera/imgae": "misnamed_topic",
        "/odometer": "unpublished",
        "/map/load": "unserved",
        "/twin": "same_name",
        **dict.fromkeys(("/lidar/points", "/camera/image", "/debug/count"), "unsubscribed"),
    }


@pytest.mark.parametrize("policy", PAIRS)
def test_a_mismatch_names_policy_and_both_sides(
    problems: dict[str, dict[str, Any]], policy: str
) -> None:
    found = problems[f"/qos/{policy}"]
    assert found["sides"] == [["/source"], ["/sink"]]
    assert found["text"].startswith(f"{policy}: /source offers ")
    assert "to change: " in found["text"]


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("/two/types", ("publishes std_msgs/msg/String", "subscribes to std_msgs/msg/Int32")),
        ("/points", ("/sink subscribes to it", "did you mean /lidar/points of /source?")),
        ("/camera/imgae", ("did you mean /camera/image of /source?",)),
        ("/map/load", ("no server; /sink has a client of this service",)),
        ("/twin", ("2 nodes have this name",)),
    ],
)
def test_the_text_says_what_to_mend(
    problems: dict[str, dict[str, Any]], name: str, words: tuple[str, ...]
) -> None:
    assert all(word in problems[name]["text"] for word in words), problems[name]


def test_the_table(broken: None) -> None:
    found = check("--ignore", "/qos/*", "--ignore", "/sink")
    assert found.returncode == 1
    assert found.stdout.splitlines() == [
        "PROBLEM    NAME   WHAT",
        "same name  /twin  2 nodes have this name",
        "13 topics, 3 nodes: 1 problem, 3 topics without subscription (--all lists them)",
    ]
    found = check("--all", "--ignore", "/twin", "--ignore", "/sink")
    assert found.returncode == 0, found.stdout
    row = ["unsubscribed", "/debug/count", "no subscription; /source publishes it"]
    assert row in [line.split(maxsplit=2) for line in found.stdout.splitlines()]
