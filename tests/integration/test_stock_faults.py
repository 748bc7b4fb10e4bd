"""Stock containers that misbehave in every way that is known, and how their nodes fare.

One run for all of them: the supervisor and the containers talk over real DDS on the loopback
interface. What the double really did stands in its journal.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import pytest

from tests.support.replay import Replay, replaying
from tests.support.scenes import written
from tests.support.stock import EXECUTABLE, PACKAGE, Double, install

TIMEOUT = 180.0


def node(name: str, *faults: str) -> dict[str, Any]:
    parameters = {"parameters": {"faults": list(faults)}} if faults else {}
    return {"package": "any", "plugin": "any::Node", "name": name, **parameters}


def box(name: str, *nodes: dict[str, Any], **keys: Any) -> dict[str, Any]:
    return {
        "name": f"{name}_box",
        "container_type": "stock",
        "package": PACKAGE,
        "executable": EXECUTABLE,
        "composable_nodes": list(nodes),
        **keys,
    }


CONTAINERS = [
    box("requests", node("asked_twice", "lose_request"), node("after_it")),
    box("answers", node("unanswered", "lose_answer"), node("beside_it")),
    box("failures", node("failing", "fail"), node("not_failing")),
    box("slow", node("slow", "slow:14"), node("queued")),
    box("hanging", node("hanging", "hang"), node("behind_it")),
    box("mortal", node("survivor"), node("killer", "die")),
    box("doomed", node("destroyer", "die", "die", "die"), restart={"max_restarts": 2}),
    box("deaf", node("heard"), arguments=["--mute-lists", "2"]),
]
SETTLED = {
    "/asked_twice": "loaded",
    "/after_it": "loaded",
    "/unanswered": "loaded",
    "/beside_it": "loaded",
    "/failing": "load failed",
    "/not_failing": "loaded",
    "/slow": "loaded",
    "/queued": "loaded",
    "/survivor": "loaded",
    "/killer": "loaded",
    "/heard": "loaded",
}
"""The others never settle: one hangs, one is behind it, and one is given up with its container."""


@dataclass
class Run:
    """What the run told, and what the containers did."""

    double: Double
    replay: Replay
    alive_before_stop: list[str]

    def states(self, name: str) -> list[str]:
        """The states of a node, without repetitions."""
        told = [event["state"] for event in self.replay.told(event="node", node=name)]
        return [state for i, state in enumerate(told) if i == 0 or state != told[i - 1]]

    def loaded(self, name: str) -> dict[str, Any]:
        """The event by which it was loaded at last."""
        return self.replay.told(event="component", kind="loaded", full_node_name=name)[-1]

    def reasons(self, name: str) -> str:
        return " | ".join(e["reason"] for e in self.replay.told(event="node", node=name))

    def constructed(self, name: str) -> int:
        return [each[0] for each in self.double.journal("construct")].count(name)

    def requested(self, name: str) -> int:
        return [each[0] for each in self.double.journal("load")].count(name)


@pytest.fixture(scope="module", name="run")
def _run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    folder = tmp_path_factory.mktemp("stock")
    double = install(folder)
    config = written(
        folder,
        composable_node_loading={"loading_timeout": "2 s"},
        stop={"sigint": "20 s", "sigterm": "1 s"},
        containers=CONTAINERS,
    )
    given_up = {"event": "container", "container": "/doomed_box", "state": "gave up"}
    with pytest.MonkeyPatch.context() as patch:
        for name, value in double.environment.items():
            patch.setenv(name, value)
        with replaying(config, folder / "logs", "--duration", f"{TIMEOUT:g}s") as replay:
            replay.read_until_states(SETTLED)
            if not replay.told(**given_up):
                replay.until(**given_up)
            alive = double.alive()
            replay.process.terminate()
            replay.read_all()
    return Run(double, replay, alive)


def test_a_load_whose_request_got_lost_is_sent_once_more(run: Run) -> None:
    assert run.requested("/asked_twice") == 2
    assert run.constructed("/asked_twice") == 1
    assert run.loaded("/asked_twice")["attempt"] > run.loaded("/after_it")["attempt"]
    assert "did not know the load" in run.reasons("/asked_twice")


def test_a_node_whose_answer_got_lost_is_found_in_the_list(run: Run) -> None:
    assert run.requested("/unanswered") == run.constructed("/unanswered") == 1
    loaded = run.loaded("/unanswered")
    assert loaded["confirmed_by"] == "list_nodes"
    assert "not answered" in loaded["error_message"]
    assert run.loaded("/beside_it")["confirmed_by"] == ""


def test_a_failure_has_its_reason_and_is_not_tried_again(run: Run) -> None:
    assert run.states("/failing")[-1] == "load failed"
    assert "threw an exception: as told" in run.reasons("/failing")
    assert run.requested("/failing") == 1


def test_a_slow_constructor_is_waited_for_and_reported(run: Run) -> None:
    assert run.requested("/slow") == run.constructed("/slow") == 1
    assert "LoadNode was sent" in run.reasons("/slow")
    assert "answers nothing meanwhile" in run.reasons("/slow")
    assert run.loaded("/slow")["confirmed_by"] == ""


def test_a_load_that_waits_behind_a_slow_one_is_not_reported(run: Run) -> None:
    assert run.states("/queued")[:4] == ["pending", "requested", "loading", "loaded"]
    assert "LoadNode" not in run.reasons("/queued")


def test_a_constructor_that_hangs_keeps_up_its_own_container_only(run: Run) -> None:
    assert run.requested("/hanging") == 1
    assert "loaded" not in run.states("/hanging")
    assert run.requested("/behind_it") == 0
    assert run.states("/behind_it")[:2] == ["pending", "requested"]
    assert "loading" not in run.states("/behind_it")


def test_a_container_that_dies_comes_back_with_all_of_its_nodes(run: Run) -> None:
    for name in ("/survivor", "/killer"):
        assert "lost" in run.states(name)
        assert run.states(name).index("lost") < len(run.states(name)) - 1 - run.states(name)[
            ::-1
        ].index("loaded")
    started = run.replay.told(event="process", kind="started", name="/mortal_box")
    assert len({event["pid"] for event in started}) == 2


def test_a_container_that_dies_of_every_load_is_given_up(run: Run) -> None:
    assert run.requested("/destroyer") == 3
    assert run.states("/destroyer")[-1] == "lost"


def test_a_container_that_does_not_answer_at_first_is_asked_again(run: Run) -> None:
    assert run.states("/heard")[:4] == ["pending", "requested", "loading", "loaded"]


def test_each_declared_node_is_there_once(run: Run) -> None:
    there = [name for name, state in SETTLED.items() if state == "loaded"]
    of_dead_processes = ["/survivor"]
    assert run.alive_before_stop == sorted([*there, *of_dead_processes])


def test_at_the_end_nodes_go_with_their_container(run: Run) -> None:
    assert run.replay.process.returncode == 128 + 15
    for name in ("/after_it", "/heard"):
        assert run.states(name)[-1] == "unloaded", run.reasons(name)
    assert run.states("/hanging")[-1] == "lost"
