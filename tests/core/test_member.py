from __future__ import annotations

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from play_launch.core.events import ContainerState
from play_launch.core.member import DEATHS, TABLE, MemberAction, MemberInput, MemberRecord, step

# From outside; the table itself makes REPLACED of a death.
INPUTS = [each for each in MemberInput if each is not MemberInput.REPLACED]
WISHES = {MemberInput.START, MemberInput.RESTART}
AT_REST = {ContainerState.STOPPED, ContainerState.GAVE_UP}


@pytest.mark.parametrize(("state", "said"), list(itertools.product(ContainerState, MemberInput)))
def test_every_pair_has_an_entry(state: ContainerState, said: MemberInput) -> None:
    after, actions = TABLE[state][said]
    assert len(set(actions)) == len(actions)
    if MemberAction.SPAWN in actions:
        assert (state, said) == (ContainerState.STARTING, MemberInput.SLOT)
    assert (MemberAction.QUEUE in actions) == (
        after is ContainerState.STARTING and said is not MemberInput.SLOT and bool(actions)
    )
    assert (MemberAction.BEGIN in actions) == (
        after is ContainerState.RUNNING and state is not ContainerState.RUNNING
    )
    if state is ContainerState.RUNNING and (after in AT_REST or said in DEATHS):
        assert MemberAction.LOSE in actions
    assert (MemberAction.KILL in actions) == (
        after is ContainerState.KILLING and state is not ContainerState.KILLING
    )
    if after is ContainerState.GAVE_UP and state is not after:
        assert MemberAction.REPORT_GAVE_UP in actions
    if said is MemberInput.STOP:
        assert after in {ContainerState.STOPPING, *AT_REST}


def fold(*inputs: MemberInput) -> tuple[MemberRecord, list[MemberAction]]:
    record, done = MemberRecord(), list[MemberAction]()
    for said in inputs:
        record, actions = step(record, said)
        done += actions
    return record, done


@given(
    st.lists(st.sampled_from(INPUTS)),
    st.lists(st.sampled_from([each for each in INPUTS if each not in WISHES])),
)
def test_after_a_stop_nothing_starts_by_itself(
    before: list[MemberInput], after: list[MemberInput]
) -> None:
    record, _ = fold(*before, MemberInput.STOP)
    assert not record.wanted
    for said in after:
        record, actions = step(record, said)
        assert MemberAction.QUEUE not in actions
        assert MemberAction.SPAWN not in actions
        assert not record.wanted


@given(st.lists(st.sampled_from(INPUTS)), st.sampled_from(sorted(WISHES)))
def test_a_wish_comes_true_when_the_process_has_ended(
    before: list[MemberInput], wish: MemberInput
) -> None:
    record, _ = fold(*before, wish)
    assert record.wanted
    if record.state is ContainerState.STOPPING:
        for death in DEATHS:
            after, actions = step(record, death)
            assert after.state is ContainerState.STARTING
            assert MemberAction.QUEUE in actions
    else:
        assert record.state not in AT_REST


@given(st.lists(st.sampled_from(INPUTS)))
def test_a_second_verdict_kills_nobody_twice(inputs: list[MemberInput]) -> None:
    record, _ = fold(*inputs)
    if record.state is not ContainerState.KILLING:
        return
    for said in set(INPUTS) - DEATHS:
        assert MemberAction.KILL not in step(record, said).actions
