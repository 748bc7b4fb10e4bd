"""The long session that never ran: the same each time, and what it promises is in it."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest

from benchmarks.long_session.plan import Plan
from benchmarks.long_session.write import write_session
from play_launch.postmortem.session import PastSession
from play_launch.supervisor.events import (
    ComponentEvent,
    ComponentEventKind,
    NodeState,
    NodeStateChanged,
    OutputLine,
    ProcessEvent,
    ProcessSample,
    SystemSample,
)

PLAN = Plan(nodes=13, seconds=300.0, crashes=10, lines=500)


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("long") / "session.mcap"
    write_session(path, PLAN)
    return path


def test_the_same_plan_gives_the_same_messages(bag: Path, tmp_path: Path) -> None:
    again = tmp_path / "again.mcap"
    count = write_session(again, PLAN)
    messages = list(PastSession(again).reader.messages())
    assert len(messages) == count
    assert messages == list(PastSession(bag).reader.messages())


def test_it_holds_what_it_promises(bag: Path) -> None:
    session = PastSession(bag)
    events = [happened.event for happened in session.events()]
    assert session.reader.is_complete
    assert not session.reader.damages
    kinds = Counter(type(event) for event in events)
    crashes = [
        event
        for event in events
        if isinstance(event, ComponentEvent) and event.kind is ComponentEventKind.CRASHED
    ]
    assert all(event.backtrace for event in crashes)
    assert kinds[OutputLine] == PLAN.lines + 20 * len(crashes)
    states = Counter(event.state for event in events if isinstance(event, NodeStateChanged))
    assert states[NodeState.CRASHED] == len(crashes) > 4
    assert states[NodeState.GAVE_UP] == 1
    assert states[NodeState.LOST] > 0
    assert any("bad_alloc" in event.error_message for event in crashes)
    exits = [event for event in events if isinstance(event, ProcessEvent)]
    assert {event.signal for event in exits} == {0, 11}
    assert kinds[SystemSample] == PLAN.seconds - 1
    samples = [event for event in events if isinstance(event, ProcessSample)]
    assert len({sample.key for sample in samples}) == PLAN.nodes + 10 + 2
    assert session.view.total == PLAN.nodes
    assert session.view.processes["/uploader"].restarts == 1


def test_events_are_in_their_order(bag: Path) -> None:
    stamps = [happened.event.stamp_ns for happened in PastSession(bag).events()]
    assert stamps == sorted(stamps)
