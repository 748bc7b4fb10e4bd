"""The table of managed nodes."""

from __future__ import annotations

from itertools import groupby
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
from play_launch.supervisor.difference import events_since
from play_launch.supervisor.events import ManagedNodeChanged, ManagedState
from play_launch.supervisor.goals import next_state
from play_launch.supervisor.inputs import ManagedInput
from play_launch.supervisor.world import World

State, Said = ManagedState, ManagedInput
GOALS = [*Autostart, None]


def drive(goal: Autostart | None, *inputs: ManagedInput) -> list[ManagedState]:
    """Name the states that follow, each once."""
    states = [State.ABSENT]
    for said in inputs:
        states.append(next_state(states[-1], said, goal))
    return [state for state, _ in groupby(states)][1:]


def test_it_is_configured_and_activated() -> None:
    way = (Said.UP, Said.IS_UNCONFIGURED, Said.IS_INACTIVE, Said.IS_ACTIVE)
    first = [State.ASKED, State.CONFIGURING]
    assert drive(Autostart.ACTIVATE, *way) == [*first, State.ACTIVATING, State.ACTIVE]
    assert drive(Autostart.CONFIGURE, *way[:3]) == [*first, State.INACTIVE]
    watched = [State.ASKED, State.UNCONFIGURED, State.INACTIVE, State.ACTIVE]
    assert drive(None, *way) == watched


def test_one_that_is_further_already_is_taken_as_it_is() -> None:
    for goal in Autostart:
        assert drive(goal, Said.UP, Said.IS_ACTIVE) == [State.ASKED, State.ACTIVE]
    inactive = drive(Autostart.ACTIVATE, Said.UP, Said.IS_INACTIVE)
    assert inactive == [State.ASKED, State.ACTIVATING]


@pytest.mark.parametrize("said", [Said.REFUSED, Said.OVERDUE])
@pytest.mark.parametrize("before", [(), (Said.IS_UNCONFIGURED,), (Said.IS_INACTIVE,)])
def test_the_life_after_a_failure_begins_anew(
    said: ManagedInput, before: tuple[ManagedInput, ...]
) -> None:
    for after in ((Said.GONE, Said.UP), (Said.UP,)):
        states = drive(Autostart.ACTIVATE, Said.UP, *before, said, said, *after)
        assert states.count(State.FAILED) == 1
        assert states[-1] is State.ASKED


def test_a_managed_node_that_another_program_moves_is_left_there() -> None:
    for goal in GOALS:
        assert next_state(State.ACTIVE, Said.IS_INACTIVE, goal) is State.INACTIVE
        assert next_state(State.INACTIVE, Said.IS_UNCONFIGURED, goal) is State.UNCONFIGURED
        assert next_state(State.FAILED, Said.IS_ACTIVE, goal) is State.ACTIVE


@given(st.sampled_from(list(Autostart)), st.lists(st.sampled_from(Said), max_size=20))
def test_it_gets_there_from_everywhere_if_it_does_what_it_is_asked(
    goal: Autostart, inputs: list[ManagedInput]
) -> None:
    state = drive(goal, *inputs, Said.UP, Said.GONE, Said.UP)[-1]
    answers = {
        State.ASKED: Said.IS_UNCONFIGURED,
        State.CONFIGURING: Said.IS_INACTIVE,
        State.ACTIVATING: Said.IS_ACTIVE,
    }
    while state in answers:
        state = next_state(state, answers[state], goal)
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
    list(events_since(world, now=0.0, stamp_ns=0))
    for goal in reversed(world.goals.values()):
        world.put(goal, state=State.ACTIVE)
    events = events_since(world, now=0.0, stamp_ns=0)
    units = [each.unit for each in events if isinstance(each, ManagedNodeChanged)]
    assert units == [str(key) for key in keys]
