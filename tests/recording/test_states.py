"""What happened to nodes, containers and processes can be read back from the bag."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st
from play_launch_msgs.msg import GraphEvent as GraphMessage
from play_launch_msgs.msg import StateEvent as StateMessage
from rclpy.serialization import deserialize_message

from play_launch.core.events import (
    ContainerState,
    ContainerStateChanged,
    GraphChanged,
    NodeState,
    NodeStateChanged,
    ProcessEvent,
    ProcessEventKind,
)
from play_launch.core.node_key import NodeKey
from play_launch.core.view import SystemView
from play_launch.recording import topics
from play_launch.recording.bag import McapBagWriter
from play_launch.recording.convert import convert
from tests.recording.reading import graph_changed, messages, state_event
from tests.support.structs import structs

STAMPS = st.integers(0, (2**31 - 1) * 1_000_000_000)
# Few names, so that events of one thing follow each other.
NAMES = st.sampled_from(["/a", "/b", "/[demo::Talker]"])
TEXTS = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=20)
INT32 = st.integers(-(2**31), 2**31 - 1)
UINT32 = st.integers(0, 2**32 - 1)
INT64 = st.integers(-(2**63), 2**63 - 1)
UINT64 = st.integers(0, 2**64 - 1)

EVENTS = st.one_of(
    structs(
        NodeStateChanged,
        stamp_ns=STAMPS,
        key=st.builds(NodeKey, container=NAMES, name=NAMES),
        state=st.sampled_from(NodeState),
        elapsed_ns=INT64,
        reason=TEXTS,
        pid=INT32,
        cpu_time_ns=INT64,
        unique_id=UINT64,
        attempt=UINT64,
        crashes=UINT32,
        reloads=UINT32,
    ),
    st.builds(
        ContainerStateChanged,
        stamp_ns=STAMPS,
        container=NAMES,
        state=st.sampled_from(ContainerState),
        reason=TEXTS,
        mechanism=TEXTS,
    ),
    st.builds(
        ProcessEvent,
        stamp_ns=STAMPS,
        kind=st.sampled_from(ProcessEventKind),
        name=NAMES,
        pid=INT32,
        start_time=UINT64,
        exit_code=INT32,
        signal=INT32,
        restarts=UINT32,
        message=TEXTS,
        command=st.lists(TEXTS, max_size=3).map(tuple),
    ),
)

GRAPH_CHANGES = st.builds(
    GraphChanged,
    stamp_ns=STAMPS,
    appeared=st.lists(NAMES, max_size=3).map(tuple),
    vanished=st.lists(NAMES, max_size=3).map(tuple),
    nodes=UINT32,
)


@settings(deadline=None, max_examples=50)
@given(st.lists(EVENTS, max_size=20))
def test_any_event_is_read_back_as_it_was(
    events: list[NodeStateChanged | ContainerStateChanged | ProcessEvent],
) -> None:
    with tempfile.TemporaryDirectory() as folder:
        writer = McapBagWriter(Path(folder) / "x.mcap")
        channel = writer.register(topics.STATES)
        for number, event in enumerate(events):
            ((topic, data),) = convert(event)
            assert topic is topics.STATES
            writer.write(channel, data, log_time=number, publish_time=event.stamp_ns)
        writer.close()
        # With the schema in the bag, by code that is not ours.
        read = [state_event(each.message) for each in messages(writer.path)]
    assert read == events
    live, past = SystemView(), SystemView()
    for before, after in zip(events, read, strict=True):
        live, past = live.after(before), past.after(after)
    assert live == past


@settings(deadline=None, max_examples=50)
@given(GRAPH_CHANGES)
def test_any_change_of_the_graph_is_read_back_as_it_was(event: GraphChanged) -> None:
    with tempfile.TemporaryDirectory() as folder:
        writer = McapBagWriter(Path(folder) / "x.mcap")
        ((topic, data),) = convert(event)
        writer.write(writer.register(topic), data, log_time=1, publish_time=event.stamp_ns)
        writer.close()
        (read,) = messages(writer.path)
    assert (read.topic, read.type_name) == (
        "/play_launch/graph",
        "play_launch_msgs/msg/GraphEvent",
    )
    assert graph_changed(read.message) == event
    assert graph_changed(deserialize_message(data, GraphMessage)) == event


@settings(deadline=None)
@given(EVENTS)
def test_the_installed_type_reads_the_same(
    event: NodeStateChanged | ContainerStateChanged | ProcessEvent,
) -> None:
    ((_, data),) = convert(event)
    message: Any = deserialize_message(data, StateMessage)
    assert state_event(message) == event


def test_the_definition_lists_every_state() -> None:
    words = {*NodeState.__members__, *ContainerState.__members__, *ProcessEventKind.__members__}
    for word in words:
        assert getattr(StateMessage, word) == word.lower()
