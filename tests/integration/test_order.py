"""What waits for what, run as a user runs it: real output, files, topics, services, Ctrl-C."""

from __future__ import annotations

import contextlib
import json
from pathlib import Path
from typing import Any

import pytest

from play_launch.postmortem.critical_chain import critical_chain
from play_launch.postmortem.timeline import read_timeline
from tests.support.replay import Replay, alive, replaying, run
from tests.support.scenes import node, written
from tests.support.waiting import until

TALKER = node("talker")
LISTENER = node("listener", "Listener")
FOREVER = ["sleep", "600"]


def write(folder: Path, **document: Any) -> Path:
    return written(folder, record={"ros": False}, **document)


def index(replay: Replay, **wanted: str) -> int:
    """Where in the events the first one is that has these values."""
    for position, event in enumerate(replay.seen):
        if all(event.get(key) == value for key, value in wanted.items()):
            return position
    raise AssertionError(f"there is no {wanted}; the last ones are {replay.seen[-5:]}")


def test_a_path_that_cannot_be_looked_up_is_waited_for_and_disturbs_no_member(
    tmp_path: Path,
) -> None:
    unreadable = tmp_path / ("x" * 300)  # ENAMETOOLONG: as EACCES is, but for root as well
    nodes = [
        {"name": "motor", "command": FOREVER},
        {"name": "waits", "command": FOREVER, "depends_on": [{"file": str(unreadable)}]},
        {"name": "later", "command": FOREVER, "depends_on": [{"file": "flag"}]},
    ]
    with replaying(write(tmp_path, nodes=nodes), tmp_path / "log") as replay:
        replay.read_until_up("/motor")
        (tmp_path / "flag").touch()
        replay.read_until_up("/later")
        assert len(alive(replay.descendants())) >= 2
    assert not [each for each in replay.seen if each.get("kind") == "exited"]


def test_a_chain_of_all_kinds(tmp_path: Path) -> None:
    containers = [
        {"name": "c", "composable_nodes": [LISTENER | {"depends_on": ["talker"]}, TALKER]},
        {"name": "d", "depends_on": [{"topic": "chatter"}]},
    ]
    first = "sleep 0.3; echo booting; sleep 0.3; echo ready 7; exec sleep 600"
    nodes = [
        {
            "name": "last",
            "command": FOREVER,
            "depends_on": [{"file": "flag"}, {"node": "listener"}, "d", "c"],
        },
        {
            "name": "flags",
            "command": ["touch", str(tmp_path / "flag")],
            "depends_on": [
                {"name": "first", "log": "ready [0-9]$"},
                {"service": "/c/_container/load_node"},
            ],
        },
        {
            "name": "after",
            "command": FOREVER,
            "depends_on": [{"name": "flags", "condition": "exited"}],
        },
        {"name": "first", "command": ["sh", "-c", first]},
    ]
    with replaying(
        write(tmp_path, containers=containers, nodes=nodes), tmp_path / "logs"
    ) as replay:
        replay.read_until_up("/last", "/after")
        left = replay.descendants()
        replay.process.send_signal(2)
        replay.read_all()
    assert not alive(left)
    started = {name: index(replay, kind="started", name=name) for name in ("/last", "/flags", "/d")}
    assert index(replay, event="node", node="/talker", state="loaded") < index(
        replay, event="node", node="/listener", state="requested"
    )
    assert index(replay, event="node", node="/talker", state="loaded") < started["/d"]
    assert index(replay, event="output", text="ready 7") < started["/flags"] < started["/last"]
    assert index(replay, event="node", node="/listener", state="loaded") < started["/last"]
    # What waits is there from the beginning, with what it waits for.
    waiting = replay.seen[index(replay, kind="waiting", name="/after")]
    assert waiting["message"] == "waits for /flags to exit with status 0"
    # Stopped in reverse order.
    ended = {name: index(replay, kind="exited", name=name) for name in ("/last", "/c", "/d")}
    assert ended["/last"] < index(replay, kind="stopping", name="/c")
    assert ended["/last"] < index(replay, kind="stopping", name="/d")
    timeline = read_timeline(replay.bag)
    chains = {
        unit.name: [link.name for link in critical_chain(timeline, unit)] for unit in timeline.units
    }
    assert chains["/listener"] == ["/listener", "/talker", "/c"]
    assert chains["/after"] == ["/after", "/flags", "/first"]


def test_rclpy_is_not_imported_without_need(tmp_path: Path) -> None:
    nodes = [
        {"name": "one", "command": FOREVER},
        {"name": "two", "command": FOREVER, "depends_on": ["one", {"file": "/"}]},
    ]
    with replaying(write(tmp_path, nodes=nodes), tmp_path / "logs") as replay:
        replay.read_until_up("/two")
        assert "_rclpy" not in Path(f"/proc/{replay.pid}/maps").read_text(encoding="utf-8")


def test_the_node_that_watches_the_graph_leaves_when_nothing_waits(tmp_path: Path) -> None:
    nodes = [
        {"name": "two", "command": FOREVER, "depends_on": [{"node": "talker"}]},
    ]
    containers = [{"name": "c", "composable_nodes": [TALKER | {"start_delay": "500 ms"}]}]
    config = write(tmp_path, containers=containers, nodes=nodes)
    with replaying(config, tmp_path / "logs") as replay:
        replay.read_until_up("/two")
        assert "_rclpy" in Path(f"/proc/{replay.pid}/maps").read_text(encoding="utf-8")

        def threads() -> list[str]:
            names = []
            for task in Path(f"/proc/{replay.pid}/task").iterdir():
                # One that is leaving may be gone by now.
                with contextlib.suppress(OSError):
                    names.append((task / "comm").read_text(encoding="utf-8").strip())
            return names

        until(lambda: not any(name.startswith("dds.ev") for name in threads()), "its end")


@pytest.mark.parametrize(("on_timeout", "code"), [("fail", 1), ("start", 0)])
def test_what_never_comes(tmp_path: Path, on_timeout: str, code: int) -> None:
    dependency = {"topic": "/absent", "timeout": "300 ms", "on_timeout": on_timeout}
    nodes = [{"name": "late", "command": ["true"], "depends_on": [dependency]}]
    with replaying(write(tmp_path, nodes=nodes), tmp_path / "logs") as replay:
        replay.read_all()
    assert replay.process.returncode == code
    kinds = [event["kind"] for event in replay.seen if event.get("name") == "/late"]
    assert kinds == ["waiting", *(["gave_up"] if code else ["started", "exited"])]


def test_the_graph_is_printed(tmp_path: Path) -> None:
    composable_nodes = [TALKER, LISTENER | {"depends_on": ["talker"]}]
    containers = [{"name": "c", "composable_nodes": composable_nodes}]
    process = {"name": "p", "command": ["x"], "start_delay": 1, "depends_on": [{"topic": "a"}]}
    config = write(tmp_path, containers=containers, nodes=[process])

    def check(*options: str) -> str:
        return run("check", config, "--graph", *options, code=0).stdout

    assert check() == (
        "/c\n  /talker\n  /listener\n      waits for /talker to be loaded\n"
        "/p\n    waits for a publisher of /a\n    waits 1 s\n"
    )
    graph = json.loads(check("--json"))["graph"]
    assert graph["units"][1] == {"unit": "/c:/talker", "container": "/c", "delay": 0.0}
    assert graph["dependencies"][0] == {
        "of": "/c:/listener",
        "condition": "loaded",
        "on": "/c:/talker",
        "subject": None,
        "timeout": None,
        "on_timeout": "fail",
    }
