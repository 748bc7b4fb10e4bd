"""The table of managed nodes."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from play_launch.config.model import (
    Autostart,
    ComposableNodeConfig,
    ContainerConfig,
    ManagedConfig,
    ReplayConfig,
)
from play_launch.config.node_key import NodeKey
from play_launch.supervisor.difference import Snapshot, events_between
from play_launch.supervisor.events import ManagedNodeChanged, ManagedState
from play_launch.supervisor.goals import ManagedAction, next_state
from play_launch.supervisor.inputs import ManagedInput
from play_launch.supervisor.world import World

State, Said, Do = ManagedState, ManagedInput, ManagedAction
GOALS = [*Autostart, None]


def drive(
    goal: Autostart | None, *inputs: ManagedInput
) -> tuple[ManagedState, list[ManagedAction]]:
    state, done = State.ABSENT, list[ManagedAction]()
    for said in inputs:
        state, actions = next_state(state, said, goal)
        done += actions
    return state, done


def test_it_is_configured_and_activated() -> None:
    way = (Said.UP, Said.IS_UNCONFIGURED, Said.IS_INACTIVE, Said.IS_ACTIVE)
    assert drive(Autostart.ACTIVATE, *way) == (State.ACTIVE, [Do.ASK, Do.CONFIGURE, Do.ACTIVATE])
    assert drive(Autostart.CONFIGURE, *way[:3]) == (State.INACTIVE, [Do.ASK, Do.CONFIGURE])
    assert drive(None, *way) == (State.ACTIVE, [Do.ASK])


def test_one_that_is_further_already_is_taken_as_it_is() -> None:
    assert drive(Autostart.ACTIVATE, Said.UP, Said.IS_ACTIVE) == (State.ACTIVE, [Do.ASK])
    assert drive(Autostart.CONFIGURE, Said.UP, Said.IS_ACTIVE) == (State.ACTIVE, [Do.ASK])
    inactive = drive(Autostart.ACTIVATE, Said.UP, Said.IS_INACTIVE)
    assert inactive == (State.ACTIVATING, [Do.ASK, Do.ACTIVATE])


@pytest.mark.parametrize("said", [Said.REFUSED, Said.OVERDUE])
@pytest.mark.parametrize("before", [(), (Said.IS_UNCONFIGURED,), (Said.IS_INACTIVE,)])
def test_a_failure_is_reported_once_and_the_next_life_begins_anew(
    said: ManagedInput, before: tuple[ManagedInput, ...]
) -> None:
    goal = Autostart.ACTIVATE
    state, done = drive(goal, Said.UP, *before, said, said)
    assert state is State.FAILED
    assert done.count(Do.REPORT_FAILED) == 1
    assert next_state(state, Said.GONE, goal) == (State.ABSENT, (Do.LEAVE,))
    assert next_state(State.ABSENT, Said.UP, goal) == (State.ASKED, (Do.ASK,))
    assert next_state(state, Said.UP, goal) == (State.ASKED, (Do.LEAVE, Do.ASK))


def test_who_is_moved_by_somebody_else_is_left_there() -> None:
    for goal in GOALS:
        assert next_state(State.ACTIVE, Said.IS_INACTIVE, goal) == (State.INACTIVE, ())
        assert next_state(State.INACTIVE, Said.IS_UNCONFIGURED, goal) == (State.UNCONFIGURED, ())
        assert next_state(State.FAILED, Said.IS_ACTIVE, goal) == (State.ACTIVE, ())


@given(st.sampled_from(GOALS), st.lists(st.sampled_from(Said), max_size=30))
def test_conversations_never_overlap_and_nothing_is_asked_of_the_absent(
    goal: Autostart | None, inputs: list[ManagedInput]
) -> None:
    state, is_talking = State.ABSENT, False
    for said in inputs:
        state, actions = next_state(state, said, goal)
        for action in actions:
            if action is Do.LEAVE:
                is_talking = False
            elif action is Do.ASK:
                assert not is_talking
                is_talking = True
            else:
                assert is_talking
                assert goal is not None
                assert action is not Do.ACTIVATE or goal is Autostart.ACTIVATE
        assert is_talking is (state is not State.ABSENT)


@given(st.sampled_from(list(Autostart)), st.lists(st.sampled_from(Said), max_size=20))
def test_it_gets_there_from_everywhere_if_it_does_what_it_is_asked(
    goal: Autostart, inputs: list[ManagedInput]
) -> None:
    state, _ = drive(goal, *inputs)
    state, _ = next_state(state, Said.GONE, goal)
    state, actions = next_state(state, Said.UP, goal)
    answers = {
        Do.ASK: Said.IS_UNCONFIGURED,
        Do.CONFIGURE: Said.IS_INACTIVE,
        Do.ACTIVATE: Said.IS_ACTIVE,
    }
    while actions:
        state, actions = next_state(state, answers[actions[-1]], goal)
    reached = {Autostart.CONFIGURE: State.INACTIVE, Autostart.ACTIVATE: State.ACTIVE}
    assert state is reached[goal]


def test_events_of_goals_have_one_order() -> None:
    keys = [NodeKey("/c", f"/n{index}") for index in range(8)]
    container = ContainerConfig(
        name="c",
        namespace="/",
        full_name="/c",
        composable_nodes=tuple(
            ComposableNodeConfig(
                package="demo", plugin="demo::Node", name=key.name[1:], namespace="/", key=key
            )
            for key in keys
        ),
    )
    config = ReplayConfig(
        name="one",
        source=Path("one.yaml"),
        text=b"",
        containers=(container,),
        managed={
            str(key): ManagedConfig(name=key.name, autostart=Autostart.ACTIVATE, timeout=5.0)
            for key in keys
        },
    )
    world = World(config)
    before = Snapshot.of(world)
    for goal in reversed(world.goals.values()):
        world.put(goal, state=State.ACTIVE)
    events = events_between(before, world, now=0.0, stamp_ns=0)
    units = [each.unit for each in events if isinstance(each, ManagedNodeChanged)]
    assert units == [str(key) for key in keys]
