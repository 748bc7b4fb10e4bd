"""Events come back from a recording as they were."""

from __future__ import annotations

import tempfile
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from play_launch.container.cdr.messages import PROCESS_STATS, log_message
from play_launch.container.cdr.structure import Layout
from play_launch.postmortem.bag_reader import Message, RecordedTopic
from play_launch.postmortem.events import event_of
from play_launch.postmortem.past_session import PastSession
from play_launch.postmortem.units import ending
from play_launch.recording import topics
from play_launch.recording.bag import BagWriter
from play_launch.recording.forms import convert
from play_launch.recording.topics import METADATA_NAME
from play_launch.supervisor.events import (
    ComponentEvent,
    ComponentEventKind,
    LogRecord,
    OutputLine,
    ProcessEventKind,
    RunEvent,
    Stream,
    SubjectKind,
)
from tests.postmortem.scenes import Scene
from tests.recording.test_states import (
    EVENTS,
    GRAPH_CHANGES,
    GROUP_SAMPLES,
    INT32,
    NAMES,
    PROCESS_SAMPLES,
    STAMPS,
    SYSTEM_SAMPLES,
    TEXTS,
    UINT64,
)

OTHERS = st.one_of(
    GRAPH_CHANGES,
    SYSTEM_SAMPLES,
    PROCESS_SAMPLES,
    GROUP_SAMPLES,
    st.builds(
        OutputLine,
        stamp_ns=STAMPS,
        process=NAMES,
        pid=st.integers(0, 2**22),
        stream=st.sampled_from(Stream),
        text=TEXTS,
        truncated=st.booleans(),
    ),
    st.builds(
        LogRecord,
        stamp_ns=STAMPS,
        level=st.sampled_from([10, 20, 30, 40]),
        name=TEXTS,
        message=TEXTS,
        file=TEXTS,
        function=TEXTS,
        line=st.integers(0, 2**32 - 1),
    ),
    st.builds(
        ComponentEvent,
        stamp_ns=STAMPS,
        kind=st.sampled_from(ComponentEventKind),
        container=NAMES,
        unique_id=UINT64,
        attempt=st.integers(1, 2**64 - 1),  # of a guest, a state is recorded as well
        full_node_name=NAMES,
        package_name=TEXTS,
        plugin_name=TEXTS,
        error_message=TEXTS,
        pid=INT32,
        start_time=UINT64,
        exit_code=INT32,
        signal=INT32,
        backtrace=st.lists(TEXTS, max_size=3).map(tuple),
        modules=st.lists(TEXTS, max_size=3).map(tuple),
        confirmed_by=TEXTS,
    ),
)

EVERYTHING = st.one_of(EVENTS, OTHERS)


EVENT_BEFORE_MODULES = Layout(
    "stamp:t event_type:B unique_id:Q attempt:Q full_node_name:s package_name:s plugin_name:s "
    "error_message:s pid:i start_time:Q exit_code:i signal:i backtrace:s[] confirmed_by:s"
)


def record(path: Path, events: list[RunEvent], damage: bytes = b"") -> Path:
    writer = BagWriter(path)
    writer.metadata(METADATA_NAME, {"name": "x", "started_ns": "500", "ros_distro": "jazzy"})
    channels = {topic: writer.register(topic) for topic in topics.ALL_TOPICS}
    for number, event in enumerate(events):
        for topic, data, _ in convert(event):
            if topic not in channels:
                channels[topic] = writer.register(topic)
            writer.write(channels[topic], data, log_time=1000 + number, publish_time=event.stamp_ns)
    if damage:
        writer.write(channels[topics.STATES], damage, log_time=0, publish_time=0)
    writer.close()
    return writer.path


@settings(max_examples=50)
@given(st.lists(EVENTS | OTHERS, max_size=20))
def test_any_event_is_read_back_as_it_was(events: list[RunEvent]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        session = PastSession(record(Path(folder) / "x.mcap", events))
        happened = list(session.events())
    assert [each.event for each in happened] == events
    assert session.started_ns == 500
    assert session.reader.damages == []


def test_a_message_that_is_no_event_is_damage_and_the_rest_is_read(tmp_path: Path) -> None:
    line = OutputLine(stamp_ns=1, process="/a", pid=7, stream=Stream.STDOUT, text="here")
    session = PastSession(record(tmp_path / "x.mcap", [line], b"\0\1\0\0nonsense"))
    assert [each.event for each in session.events()] == [line]
    (damage,) = session.reader.damages
    assert "/play_launch/states" in damage.reason


def test_the_graph_as_earlier_versions_recorded_it_is_passed_over(tmp_path: Path) -> None:
    log = log_message(1, 20, "graph", "appeared /a; 1 nodes")
    writer = BagWriter(tmp_path / "x.mcap")
    channel = writer.register(replace(topics.GRAPH, type_name="rcl_interfaces/msg/Log"))
    writer.metadata(METADATA_NAME, {"name": "x", "started_ns": "500"})
    writer.write(channel, log, log_time=1, publish_time=1)
    writer.close()
    session = PastSession(writer.path)
    assert list(session.events()) == []
    assert session.reader.damages == []


@given(st.text(st.characters(codec="ascii", exclude_characters="\0"), max_size=9))
def test_an_event_of_an_earlier_version_has_no_modules(confirmed_by: str) -> None:
    data = EVENT_BEFORE_MODULES.write({"stamp": 5, "confirmed_by": confirmed_by})
    topic = RecordedTopic(topics.COMPONENT_EVENTS.name, topics.COMPONENT_EVENTS.type_name, "cdr")
    event = event_of(Message(topic, 0, 0, data, 0, 0))
    assert isinstance(event, ComponentEvent)
    assert (event.stamp_ns, event.confirmed_by) == (5, confirmed_by)
    assert (event.modules, event.container) == ((), "")


@pytest.mark.parametrize("about", [(SubjectKind.NODE, "/not_a_node"), (SubjectKind.NODE, "")])
def test_a_sample_of_an_unknown_process_is_damage(
    tmp_path: Path, about: tuple[SubjectKind, str]
) -> None:
    writer = BagWriter(tmp_path / "x.mcap")
    channel = writer.register(replace(topics.stats_topic(SubjectKind.PROCESS, "/a"), about=about))
    writer.write(channel, PROCESS_STATS.write({}), log_time=1, publish_time=1)
    writer.close()
    session = PastSession(writer.path)
    assert list(session.events()) == []
    assert len(session.reader.damages) == 1
    assert "is not the key of a node" in session.reader.damages[0].reason


@pytest.mark.parametrize(
    ("signal", "code", "reason", "what"),
    [
        (11, 0, "SIGSEGV (no memory at address 0x0)", "SIGSEGV"),
        (6, 0, "SIGABRT (uncaught exception std::runtime_error: no) in", "std::runtime_error"),
        (6, 0, "SIGABRT (uncaught exception int) in thread", "int"),
        (0, 3, "", "exit status 3"),
        (77, 0, "", "signal 77"),
    ],
)
def test_how_it_ended_in_a_word(signal: int, code: int, reason: str, what: str) -> None:
    assert ending(signal, code, reason) == what


def test_what_was_applied_last_says_where_a_unit_is_declared(tmp_path: Path) -> None:
    def declared(line: int, *names: str) -> dict[str, object]:
        nodes = [{"full_name": each, "line": line, "file": f"{line}.yaml"} for each in names]
        return {"nodes": nodes}

    scene = Scene(
        resolved=declared(3, "/old", "/kept"),
        applied=[declared(5, "/kept", "/new"), declared(7, "/new")],
    )
    for name in ("/old", "/kept", "/new"):
        scene.process(1, ProcessEventKind.GAVE_UP, name, message="no file")
    found = scene.story(tmp_path).findings
    assert {each.key: each.place.config for each in found} == {
        "/old": "3.yaml:3",
        "/kept": "5.yaml:5",
        "/new": "7.yaml:7",
    }
