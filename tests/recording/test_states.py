"""What happened, and what was measured, can be read back from the bag."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import fields, replace
from play_launch_msgs.msg import StateEvent as StateMessage
from rclpy.serialization import deserialize_message
from rclpy.validate_full_topic_name import validate_full_topic_name

from play_launch.config.node_key import NodeKey
from play_launch.container.cdr.messages import STATE_EVENT
from play_launch.container.cdr.structure import Layout
from play_launch.postmortem.bag_reader import Message, RecordedTopic
from play_launch.postmortem.events import event_of
from play_launch.recording import topics
from play_launch.recording.bag import BagWriter
from play_launch.recording.forms import convert
from play_launch.supervisor.endpoints import Endpoint
from play_launch.supervisor.events import (
    ContainerState,
    ContainerStateChanged,
    GraphChanged,
    GroupSample,
    MachineChanged,
    MachineState,
    MemoryKind,
    NodeState,
    NodeStateChanged,
    ProcessEvent,
    ProcessEventKind,
    ProcessSample,
    RunEvent,
    SubjectKind,
    SystemSample,
    Withdrawn,
)
from play_launch.supervisor.outcome import Cause, Sequel
from play_launch.supervisor.view import SystemView
from tests.recording.reading import messages, state_event
from tests.support.structs import structs

STAMPS = st.integers(0, (2**31 - 1) * 1_000_000_000)
# Few names, so that events of one thing follow each other.
NAMES = st.sampled_from(["/a", "/b", "/[demo::Talker]"])
TEXTS = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=20)
INT32 = st.integers(-(2**31), 2**31 - 1)
UINT32 = st.integers(0, 2**32 - 1)
INT64 = st.integers(-(2**63), 2**63 - 1)
UINT64 = st.integers(0, 2**64 - 1)
OUTCOMES: dict[str, Any] = {
    "cause": st.sampled_from(Cause),
    "sequel": st.sampled_from(Sequel),
    "delay_ns": INT64,
    "culprit": TEXTS,
}
OLD_STATE_EVENT = Layout(
    " ".join(f"{name}:{kind}" for name, kind in STATE_EVENT.types.items() if name not in OUTCOMES)
)

MACHINES = structs(
    MachineChanged,
    stamp_ns=STAMPS,
    machine=NAMES,
    state=st.sampled_from(MachineState),
    reason=TEXTS,
)
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
        **OUTCOMES,
    ),
    st.builds(
        ContainerStateChanged,
        stamp_ns=STAMPS,
        container=NAMES,
        state=st.sampled_from(ContainerState),
        reason=TEXTS,
        mechanism=TEXTS,
        **OUTCOMES,
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
        **OUTCOMES,
    ),
)

ENDPOINTS = st.builds(
    Endpoint,
    topic=NAMES,
    node=NAMES,
    type=NAMES,
    is_publisher=st.booleans(),
    reliability=st.integers(0, 5),
    durability=st.integers(0, 5),
    liveliness=st.integers(0, 5),
    deadline=st.integers(0, 2**63 - 1),
    lease_duration=st.integers(0, 2**63 - 1),
)
GRAPH_CHANGES = st.builds(
    GraphChanged,
    stamp_ns=STAMPS,
    appeared=st.lists(NAMES, max_size=3).map(tuple),
    vanished=st.lists(NAMES, max_size=3).map(tuple),
    nodes=UINT32,
    endpoints_appeared=st.lists(ENDPOINTS, max_size=3).map(tuple),
    endpoints_vanished=st.lists(ENDPOINTS, max_size=3).map(tuple),
)


FLOATS = st.floats(allow_nan=False)
SUBJECTS = st.sampled_from(
    [
        (SubjectKind.CONTAINER, "/a"),
        (SubjectKind.PROCESS, "/[demo::Talker]"),
        (SubjectKind.NODE, "/b:/a"),
        (SubjectKind.NODE, "/b:/[demo::Talker:2]"),
    ]
)
VALUES: dict[Any, st.SearchStrategy[Any]] = {
    int: st.integers(0, 2**31 - 1),
    float: FLOATS,
    tuple[float, ...]: st.lists(FLOATS, max_size=4).map(tuple),
    MemoryKind: st.sampled_from(MemoryKind),
    SubjectKind: st.none(),
    str: st.none(),
}


def samples(kind: type[ProcessSample | GroupSample | SystemSample]) -> st.SearchStrategy[Any]:
    """Samples with any values, of the subjects that there are."""

    def of(subject: tuple[SubjectKind, str]) -> st.SearchStrategy[Any]:
        about = dict(zip(("kind", "key"), map(st.just, subject), strict=True))
        known = {each.name: VALUES[each.type] for each in fields(kind)}
        return structs(kind, **{name: about.get(name, value) for name, value in known.items()})

    return SUBJECTS.flatmap(of)


PROCESS_SAMPLES, GROUP_SAMPLES = samples(ProcessSample), samples(GroupSample)
SYSTEM_SAMPLES = samples(SystemSample)


@settings(deadline=None, max_examples=50)
@given(st.lists(EVENTS, max_size=20))
def test_any_event_is_read_back_as_it_was(
    events: list[NodeStateChanged | ContainerStateChanged | ProcessEvent],
) -> None:
    with tempfile.TemporaryDirectory() as folder:
        writer = BagWriter(Path(folder) / "x.mcap")
        channel = writer.register(topics.STATES)
        for number, event in enumerate(events):
            ((topic, data, _),) = convert(event)
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


@given(EVENTS)
def test_states_of_an_earlier_version_have_no_cause(
    event: NodeStateChanged | ContainerStateChanged | ProcessEvent,
) -> None:
    plain = replace(event, cause=Cause.NOT_RECORDED, sequel=Sequel.NONE, delay_ns=0, culprit="")
    ((_, data, _),) = convert(plain)
    fields = STATE_EVENT.read(data)
    old = {name: fields[name] for name in OLD_STATE_EVENT.types}
    topic = RecordedTopic(topics.STATES.name, topics.STATES.type_name, "cdr")
    assert event_of(Message(topic, 1, 1, OLD_STATE_EVENT.write(old), 1, 0)) == plain


@settings(deadline=None, max_examples=100)
@given(
    st.one_of(
        EVENTS,
        GRAPH_CHANGES,
        PROCESS_SAMPLES,
        GROUP_SAMPLES,
        SYSTEM_SAMPLES,
        MACHINES,
    )
)
def test_our_own_reader_gives_the_event_back(event: RunEvent) -> None:
    ((topic, data, _),) = convert(event)
    read = RecordedTopic(
        topic.name,
        topic.type_name,
        "cdr",
        topic.metadata.get(topics.KIND, ""),
        topic.metadata.get(topics.KEY, ""),
    )
    assert event_of(Message(read, 0, 0, data, channel=1)) == event


@pytest.mark.parametrize(
    ("kind", "key", "name"),
    [
        (SubjectKind.CONTAINER, "/perception", "/play_launch/container/perception/stats"),
        (SubjectKind.PROCESS, "/tools/rviz", "/play_launch/node/tools/rviz/stats"),
        (SubjectKind.NODE, "/perception:/lidar/front", "/play_launch/node/lidar/front/stats"),
        (
            SubjectKind.NODE,
            "/perception:/ns/[demo::Talker:2]",
            "/play_launch/node/perception/ns/demo_Talker_2/stats",
        ),
        (SubjectKind.PROCESS, "/[3d_viewer]", "/play_launch/node/_3d_viewer/stats"),
    ],
)
def test_the_topic_of_a_sample_is_one_that_ros_allows(
    kind: SubjectKind, key: str, name: str
) -> None:
    assert topics.stats_topic(kind, key).name == name
    beside = topics.group_topic(kind, key).name
    assert beside == name.replace("/stats", "/cgroup")
    for each in (name, beside):
        validate_full_topic_name(each)


def test_the_definition_lists_every_state() -> None:
    words = {*NodeState.__members__, *ContainerState.__members__, *ProcessEventKind.__members__}
    for word in words:
        assert getattr(StateMessage, word) == word.lower()


@given(SUBJECTS)
def test_what_was_taken_out_comes_back_as_the_last_state(subject: tuple[SubjectKind, str]) -> None:
    kind, key = subject
    event = Withdrawn(stamp_ns=1, kind=kind, key=key)
    ((topic, data, latest),) = convert(event)
    assert latest == f"{kind} {key}", "it takes the place of the state before"
    message: Any = deserialize_message(data, StateMessage)
    assert (message.state, message.key) == (StateMessage.WITHDRAWN, key)
    assert f"{message.container}:{message.name}" == key or message.name == key
    read = event_of(Message(RecordedTopic(topic.name, topic.type_name, "cdr"), 1, 1, data, 1, 0))
    assert read == event
