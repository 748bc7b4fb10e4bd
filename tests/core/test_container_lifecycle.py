from __future__ import annotations

import itertools

import pytest

from play_launch.core.container_lifecycle import (
    TABLE,
    ContainerAction,
    ContainerInput,
)
from play_launch.core.events import ContainerState

ALIVE = {ContainerState.STARTING, ContainerState.RUNNING, ContainerState.STOPPING}


@pytest.mark.parametrize(("state", "said"), list(itertools.product(ContainerState, ContainerInput)))
def test_every_pair_has_an_entry(state: ContainerState, said: ContainerInput) -> None:
    after, actions = TABLE[state][said]
    if ContainerAction.SPAWN in actions:
        assert state not in ALIVE, "two processes for one container"
        assert after is ContainerState.STARTING
    if ContainerAction.LOAD_NODES in actions:
        assert after is ContainerState.RUNNING
    if state is ContainerState.RUNNING and after not in ALIVE:
        assert ContainerAction.LOSE_NODES in actions
    if said is ContainerInput.STOP_REQUESTED:
        assert after not in {ContainerState.STARTING, ContainerState.RUNNING}


@pytest.mark.parametrize("state", ContainerState)
def test_after_a_stop_nothing_starts_by_itself(state: ContainerState) -> None:
    reached = {TABLE[state][ContainerInput.STOP_REQUESTED].state}
    inputs = set(ContainerInput) - {ContainerInput.START_REQUESTED}
    while True:
        further = {TABLE[here][said].state for here in reached for said in inputs} - reached
        if not further:
            break
        reached |= further
    assert not reached & {ContainerState.STARTING, ContainerState.RUNNING}
