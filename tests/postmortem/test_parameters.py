"""What recordings say about parameters."""

from __future__ import annotations

import json
import subprocess
from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st

from play_launch.cli.explain import paragraphs
from play_launch.container.cdr.messages import NODE_PARAMETERS
from play_launch.postmortem.bag_reader import Message, RecordedTopic
from play_launch.postmortem.comparison import ParameterChange, compare
from play_launch.postmortem.events import UnreadableEventError
from play_launch.postmortem.parameters import (
    Changed,
    KnownParameters,
    Parameters,
    ParametersOfALife,
    shortened,
)
from play_launch.postmortem.timeline import read_timeline
from play_launch.recording import topics
from play_launch.supervisor.events import NodeState
from tests.postmortem.scenes import Scene, ns
from tests.support.replay import COMMAND

if TYPE_CHECKING:
    from pathlib import Path


def message(data: bytes, topic: str = topics.PARAMETERS.name, type_name: str = "") -> Message:
    known = RecordedTopic(topic, type_name or topics.PARAMETERS.type_name, "cdr")
    return Message(known, log_time=1, publish_time=1, data=data, channel=1)


def test_answers_and_changes(tmp_path: Path) -> None:
    scene = Scene()
    scene.parameters_changed(1, "/arm", new={"speed": 0.5})
    scene.parameters(2, "/arm", speed=1.0, tool="gripper", limits=("a", "b"), raw=b"\x01\xff")
    scene.no_parameters(2.5, "/deaf", "it did not answer in time")
    scene.parameters_changed(3, "/arm", changed={"speed": 2.0, "tool": "gripper"})
    scene.parameters_changed(4, "/arm", deleted={"tool": None}, new={"late": True})
    scene.parameters_changed(5, "/unasked", changed={"gain": 3})
    nodes = scene.story(tmp_path).parameters.nodes
    arm = nodes["/arm"]
    assert (arm.asked_ns, arm.error) == (ns(2), "")
    assert arm.values == {
        "speed": "2.0",
        "limits": '["a", "b"]',
        "raw": '"01 ff"',
        "late": "true",
    }
    assert arm.changes == [
        Changed(ns(3), "speed", "1.0", "2.0"),
        Changed(ns(4), "tool", '"gripper"', None),
    ]
    assert (nodes["/deaf"].asked_ns, nodes["/deaf"].error) == (0, "it did not answer in time")
    assert nodes["/unasked"].changes == [Changed(ns(5), "gain", None, "3")]


def test_a_later_answer_replaces_an_earlier_one(tmp_path: Path) -> None:
    scene = Scene()
    scene.parameters(1, "/arm", speed=1.0, old=1)
    scene.parameters(2, "/arm", speed=2.0)
    scene.no_parameters(3, "/arm", "it did not answer in time")
    arm = scene.story(tmp_path).parameters.nodes["/arm"]
    assert (arm.values, arm.asked_ns) == ({"speed": "2.0"}, ns(2))
    assert arm.error


def test_what_differs_between_two_sessions(tmp_path: Path) -> None:
    before, after = Scene(), Scene()
    before.parameters(1, "/arm", same=1, speed=1.0, gone="x")
    after.parameters(1, "/arm", same=1, speed=1.0, new=True)
    after.parameters_changed(2, "/arm", changed={"speed": 1.5})
    before.parameters(1, "/deaf", a=1)
    after.no_parameters(1, "/deaf", "it did not answer in time")
    before.parameters(1, "/only", a=1)
    paths = before.record(tmp_path / "a.mcap"), after.record(tmp_path / "b.mcap")
    found = compare(*map(read_timeline, paths))
    assert found.parameters == (
        ParameterChange("/arm", "gone", '"x"', None),
        ParameterChange("/arm", "new", None, "true"),
        ParameterChange("/arm", "speed", "1.0", "1.5"),
    )
    assert not found.is_worse


def test_changes_of_one_node_are_limited(tmp_path: Path) -> None:
    scene = Scene()
    for number in range(1500):
        scene.parameters_changed(1 + number / 1000, "/arm", changed={"speed": number})
    arm = scene.story(tmp_path).parameters.nodes["/arm"]
    assert (len(arm.changes), arm.further_changes) == (1000, 500)
    assert arm.values == {"speed": "1499"}


def test_another_type_of_that_name_is_passed_over() -> None:
    parameters = Parameters()
    parameters.take(message(b"anything", "/parameter_events", "std_msgs/msg/String"))
    assert parameters.nodes == {}


@given(st.binary(max_size=80))
def test_damaged_messages_are_refused_in_one_way(data: bytes) -> None:
    parameters = Parameters()
    for topic in (topics.PARAMETERS, topics.PARAMETER_EVENTS):
        try:
            parameters.take(message(b"\0\1\0\0" + data, topic.name, topic.type_name))
        except UnreadableEventError as error:
            assert topic.name in str(error)  # noqa: PT017 - either is right


def test_an_unknown_type_of_parameter_is_damage() -> None:
    values = ({"name": "a", "value": {"type": 77}},)
    data = NODE_PARAMETERS.write({"stamp": 1, "node": "/arm", "parameters": values})
    with pytest.raises(UnreadableEventError, match="77"):
        Parameters().take(message(data))


def test_long_values_are_shortened() -> None:
    assert shortened("x" * 200) == "x" * 200
    assert shortened("x" * 201) == "x" * 200 + "... (201 characters)"


def test_a_failure_names_the_parameters_of_that_life(tmp_path: Path) -> None:
    scene = Scene()
    scene.started()
    scene.node(1, "/arm", NodeState.LOADED)
    scene.parameters(2, "/arm", use_sim_time=False, speed=1.0, tool="gripper")
    scene.parameters_changed(3, "/arm", changed={"speed": 2.0})
    scene.crashed(3.5, "/arm")
    scene.node(4, "/arm", NodeState.LOADED)
    scene.crashed(4.5, "/arm", "demo::other()")  # before it was asked again
    story = scene.story(tmp_path)
    first, second = story.findings
    assert first.parameters == ParametersOfALife(
        (("speed", "2.0"), ("tool", '"gripper"'), ("use_sim_time", "false")),
        (Changed(ns(3), "speed", "1.0", "2.0"),),
    )
    assert second.parameters is None
    lines = [line.strip() for line in paragraphs(story.findings, story.timeline)]
    assert "Its parameter speed changed from 1.0 to 2.0 500 ms before." in lines
    assert 'Its parameters: speed 2.0, tool "gripper".' in lines
    assert sum("parameter" in line for line in lines) == 2


@given(st.dictionaries(st.text(), st.text(), max_size=20), st.integers(0, 9), st.integers(0, 9))
def test_a_life_has_what_was_said_since_it_began(
    values: dict[str, str], asked: int, began: int
) -> None:
    known = KnownParameters(asked, "", values, [Changed(at, "p", None, "1") for at in range(10)])
    life = known.of_life(began)
    assert dict(life.values) == (values if asked >= began else {})
    assert [each.at_ns for each in life.changes] == list(range(began, 10))


def test_inspect_shows_changes_and_with_debug_all_parameters(tmp_path: Path) -> None:
    scene = Scene()
    scene.started()
    scene.parameters(1, "/arm", speed=1.0)
    scene.parameters_changed(2, "/arm", new={"late": True}, changed={"speed": 2.0})
    scene.parameters_changed(3, "/arm", new={"later": True})
    scene.no_parameters(4, "/deaf", "it did not answer in time")
    bag = scene.record(tmp_path / "a.mcap")

    def lines(*options: str) -> list[str]:
        command = [str(COMMAND), "inspect", str(bag), "--node", "/arm", "--node", "/deaf", *options]
        text = subprocess.run(command, capture_output=True, text=True, check=True).stdout
        return [line.strip() for line in text.splitlines()]

    changed = "2.000 [/arm] parameter speed changed from 1.0 to 2.0"
    answer = ["1.000 [/arm] parameters:", "1.000 [/arm]   speed 1.0"]
    assert lines() == [changed]
    silent = "4.000 [/deaf] parameters: it did not answer in time"
    assert lines("--level", "debug") == [*answer, changed, silent]
    (event,) = map(json.loads, lines("--json"))
    assert event == {
        "event": "parameters",
        "stamp_ns": ns(2),
        "node": "/arm",
        "values": None,
        "changes": [{"at_ns": ns(2), "name": "speed", "before": "1.0", "after": "2.0"}],
        "error": "",
    }
