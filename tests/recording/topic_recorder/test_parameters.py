"""Parameters of real nodes, asked for by the real program and read back."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from mcap.records import Channel
from mcap_ros2.decoder import DecoderFactory
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rosbags.highlevel import AnyReader

from play_launch.postmortem.bag_reader import BagReader
from play_launch.postmortem.parameters import TOPICS, Parameters
from play_launch.recording.topic_recorder import supervision
from play_launch.recording.topics import PARAMETERS
from tests.recording.reading import records
from tests.recording.topic_recorder.recording import Recording, recording, until
from tests.support.ros import begin

pytestmark = pytest.mark.anyio

SHORT_TIMEOUT = 500_000_000
"""Nanoseconds; only for those that do not answer."""
EVERY_TYPE = {
    "flag": True,
    "number": -(2**40),
    "rate": 2.5,
    "text": 'Ölstand "hoch"',
    "octets": [b"\x00", b"\xff"],
    "flags": [True, False],
    "numbers": [1, 2, 3],
    "rates": [0.5, -1.0],
    "texts": ["a", ""],
}
AS_JSON = {
    "flag": "true",
    "number": "-1099511627776",
    "rate": "2.5",
    "text": '"Ölstand \\"hoch\\""',
    "octets": '"00 ff"',
    "flags": "[true, false]",
    "numbers": "[1, 2, 3]",
    "rates": "[0.5, -1.0]",
    "texts": '["a", ""]',
}


@contextmanager
def node(name: str, parameters: dict[str, Any], *, spins: bool = True) -> Iterator[Node]:
    """A node of another participant; it answers if it spins."""
    context = begin()
    made = Node(name, context=context)
    for each, value in parameters.items():
        made.declare_parameter(each, value)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(made)
    thread = threading.Thread(target=executor.spin)
    if spins:
        thread.start()
    try:
        yield made
    finally:
        executor.shutdown()
        if spins:
            thread.join()
        made.destroy_node()
        context.try_shutdown()


def answers(path: Path, name: str) -> list[Any]:
    """The recorded messages about a node, as other people's reader decodes them."""
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        found = reader.iter_decoded_messages(topics=[PARAMETERS.name])
        return [each.decoded_message for each in found if each.decoded_message.node == name]


def known(path: Path) -> Parameters:
    parameters = Parameters()
    for message in BagReader(path).messages(TOPICS):
        parameters.take(message)
    return parameters


async def asked(made: Recording, count: int) -> None:
    """Wait until so many answers, or failures to answer, are in the file."""
    await until(lambda: made.recorder.messages[PARAMETERS.name] >= count, f"{count} answers")


async def test_those_of_a_node(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    with node("arm", EVERY_TYPE):
        async with recording(path, "{}") as made:
            await asked(made, 1)
    (message,) = answers(path, "/arm")
    assert message.error == ""
    assert message.stamp.sec > 1_700_000_000
    listed = {each.name: each.value for each in message.parameters}
    assert listed["number"].integer_value == EVERY_TYPE["number"]
    assert listed["texts"].string_array_value == ["a", ""]
    values = (await asyncio.to_thread(known, path)).nodes["/arm"].values
    assert {name: values[name] for name in EVERY_TYPE} == AS_JSON
    assert "use_sim_time" in values


async def test_a_message_is_as_long_as_its_values(tmp_path: Path) -> None:
    """Rosbags refuses what is left over behind them, with any number of empty lists."""
    path = tmp_path / "x.mcap"
    with ExitStack() as stack:
        for number in range(4):
            some = dict(list(EVERY_TYPE.items())[: 3 + number])
            stack.enter_context(node("arm" + "_" * number + "x", some))
        async with recording(path, "{}") as made:
            await asked(made, 4)
    with AnyReader([path]) as reader:
        found = [
            reader.deserialize(data, connection.msgtype)
            for connection, _, data in reader.messages()
            if connection.topic == PARAMETERS.name
        ]
    assert len(found) == 4


async def test_what_changes_later(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    with node("arm", {"speed": 1.0, "tool": "gripper"}) as arm:
        async with recording(path, "{}") as made:
            await asked(made, 1)
            faster = [Parameter("speed", value=1.5)]
            await asyncio.to_thread(arm.set_parameters, faster)
            await asyncio.to_thread(arm.undeclare_parameter, "tool")
            events = made.recorder.messages
            await until(lambda: events["/parameter_events"] >= 1, "the event")
    found = (await asyncio.to_thread(known, path)).nodes["/arm"]
    assert found.values["speed"] == "1.5"
    speed = next(each for each in found.changes if each.name == "speed")
    assert (speed.before, speed.after) == ("1.0", "1.5")
    assert speed.at_ns > found.asked_ns


async def test_each_life_of_a_node_is_asked(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    async with recording(path, "{}") as made:
        for number in (1, 2):
            with node("arm", {"life": number}):
                await asked(made, number)
    lives = [
        {each.name: each.value.integer_value for each in message.parameters}["life"]
        for message in answers(path, "/arm")
    ]
    assert lives == [1, 2]


@pytest.fixture
def hasty(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let nodes take no longer than `SHORT_TIMEOUT` for their answers."""
    complete = supervision.recorder_argv

    def argv(*given: Any) -> tuple[str, ...]:
        return (*complete(*given), "--answer-timeout", str(SHORT_TIMEOUT))

    monkeypatch.setattr(supervision, "recorder_argv", argv)


@pytest.mark.usefixtures("hasty")
async def test_a_node_that_never_answers_holds_up_no_other(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    with node("deaf", {"a": 1}, spins=False), node("arm", {"a": 1}):
        async with recording(path, "{}") as made:
            await asked(made, 2)
    (deaf,) = answers(path, "/deaf")
    assert (deaf.error, list(deaf.parameters)) == ("it did not answer in time", [])
    (arm,) = answers(path, "/arm")
    assert arm.error == ""
    nodes = (await asyncio.to_thread(known, path)).nodes
    assert nodes["/deaf"].error == deaf.error


@pytest.mark.usefixtures("hasty")
async def test_a_node_that_begins_to_answer_is_recorded_after_all(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    with node("late", {"a": 1}, spins=False) as late:
        async with recording(path, "{}") as made:
            await asked(made, 1)
            executor = SingleThreadedExecutor(context=late.context)
            executor.add_node(late)
            while made.recorder.messages[PARAMETERS.name] < 2:
                # Answering the requests that were given up is refused.
                with suppress(RuntimeError, SystemError):
                    await asyncio.to_thread(executor.spin_once, 0.1)
            executor.shutdown()
    failed, answered = answers(path, "/late")
    assert (failed.error, answered.error) == ("it did not answer in time", "")
    assert {"a"} < {each.name for each in answered.parameters}


async def test_many_nodes_are_all_asked_once(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    context = begin()
    executor = SingleThreadedExecutor(context=context)
    nodes = [Node(f"node_{number}", context=context) for number in range(60)]
    for number, each in enumerate(nodes):
        each.declare_parameter("number", number)
        executor.add_node(each)
    thread = threading.Thread(target=executor.spin)
    thread.start()
    try:
        async with recording(path, "{}") as made:
            await asked(made, len(nodes))
    finally:
        executor.shutdown()
        thread.join()
        for each in nodes:
            each.destroy_node()
        context.try_shutdown()
    for number in range(len(nodes)):
        (message,) = answers(path, f"/node_{number}")
        assert message.error == ""
        values = {each.name: each.value.integer_value for each in message.parameters}
        assert values["number"] == number


async def test_none_is_asked_where_that_is_excluded(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    with node("arm", {"a": 1}) as arm:
        exclude = "{exclude: [/play_launch/parameters]}"
        async with recording(path, exclude) as made:
            faster = [Parameter("a", value=2)]
            heard = made.recorder.messages

            def is_heard() -> bool:
                arm.set_parameters(faster)
                return heard["/parameter_events"] > 0

            await until(is_heard, "that events are recorded")
    # Else its channel would be the first one.
    names = [each.topic for each in records(path) if isinstance(each, Channel)]
    assert "/parameter_events" in names
    assert PARAMETERS.name not in names
