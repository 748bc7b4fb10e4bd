from __future__ import annotations

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from play_launch.core.events import NodeState
from play_launch.core.lifecycle import NodeRecord, Patience, Step, is_silent, step
from play_launch.core.node_key import NodeKey
from play_launch.core.node_table import TABLE, WAITING, NodeAction, NodeInput
from play_launch.core.questions import Asked, NodeStatusState, ids_to_ask, read_answer

from .model_container import Listed

PATIENCE = Patience(loading_timeout=10.0, report_interval=15.0)
SENDS_LOAD = {NodeAction.SEND_LOAD, NodeAction.RESEND_LOAD}


KEYS = tuple(NodeKey("/c", f"/n{number}") for number in range(5))
WISHES = {NodeInput.LOAD_REQUESTED, NodeInput.RELOAD_REQUESTED}
# From outside; the table's own words come of others.
INPUTS = [each for each in NodeInput if each is not NodeInput.REPLACED]


def run(record: NodeRecord, said: NodeInput, now: float = 0.0, **about: int) -> Step:
    return step(record, said, now=now, patience=PATIENCE, next_attempt=record.attempt + 1, **about)


def requested() -> NodeRecord:
    return run(NodeRecord(), NodeInput.CONTAINER_READY).record


def loading() -> NodeRecord:
    return run(requested(), NodeInput.ACCEPTED, attempt=1, unique_id=7).record


def loaded() -> NodeRecord:
    return run(loading(), NodeInput.LOADED, attempt=1, unique_id=7).record


@pytest.mark.parametrize(("state", "said"), list(itertools.product(NodeState, NodeInput)))
def test_every_pair_has_an_entry(state: NodeState, said: NodeInput) -> None:
    transition = TABLE[state][said]
    assert set(transition.actions) <= set(NodeAction)
    if SENDS_LOAD & set(transition.actions):
        assert transition.state is NodeState.REQUESTED
    if transition.state is NodeState.LOADED and state is not NodeState.LOADED:
        assert state in WAITING


def test_the_ordinary_way() -> None:
    assert requested().attempt == 1
    assert loading().unique_id == 7
    result = run(loading(), NodeInput.LOADED, attempt=1, unique_id=7)
    assert result.record.state is NodeState.LOADED
    assert not result.actions


def test_who_waits_in_a_queue_of_ours_is_asked_about_later_and_that_is_no_news() -> None:
    result = run(requested(), NodeInput.STATUS_QUEUED, now=12.0, attempt=1)
    assert result.record.state is NodeState.REQUESTED
    assert result.actions == ()
    assert not is_silent(result.record, 21.9)
    assert is_silent(result.record, 22.0)


def test_silence_is_a_question_and_only_the_owner_answers_it() -> None:
    record = loading()
    assert not is_silent(record, 9.9)
    assert is_silent(record, 10.0)
    silent = run(record, NodeInput.SILENT, now=10.0)
    assert silent.record.state is NodeState.LOADING
    assert silent.actions == (NodeAction.SEND_QUERY,)
    confirmed = run(silent.record, NodeInput.STATUS_LOADED, now=10.1, attempt=1, unique_id=7)
    assert confirmed.record.state is NodeState.LOADED
    assert not confirmed.actions


def test_a_slow_constructor_is_reported_every_interval() -> None:
    record = loading()
    reports = []
    for tenth in range(600):
        now = tenth / 10
        if is_silent(record, now):
            record = run(record, NodeInput.SILENT, now=now).record
            answer = run(record, NodeInput.STATUS_CONSTRUCTING, now=now, attempt=1, unique_id=7)
            record = answer.record
            assert not answer.actions
            reports.append(now)
    assert reports == [10.0, 25.0, 40.0, 55.0]


def test_a_load_is_sent_anew_once_and_under_a_new_number() -> None:
    again = run(loading(), NodeInput.STATUS_UNKNOWN, attempt=1, unique_id=7)
    assert again.actions == (NodeAction.RESEND_LOAD,)
    assert (again.record.attempt, again.record.unique_id) == (2, 0)
    late = run(again.record, NodeInput.LOADED, attempt=1, unique_id=7)
    assert late.record == again.record
    assert "attempt 1" in late.ignored
    over = run(again.record, NodeInput.STATUS_UNKNOWN, attempt=2)
    assert over.record.state is NodeState.LOAD_FAILED
    assert not over.actions


def test_another_unique_id_of_the_same_attempt_does_not_count() -> None:
    result = run(loading(), NodeInput.LOADED, attempt=1, unique_id=8)
    assert result.record == loading()
    assert "unique_id 8" in result.ignored


def test_a_contradiction_is_a_question() -> None:
    result = run(loaded(), NodeInput.LOAD_FAILED, attempt=1, unique_id=7)
    assert result.record.state is NodeState.LOADED
    assert result.actions == (NodeAction.SEND_QUERY,)


def test_what_the_container_forgot_is_not_loaded() -> None:
    result = run(loaded(), NodeInput.STATUS_UNKNOWN, attempt=1, unique_id=7)
    assert result.record.state is NodeState.LOST
    assert not result.actions


def test_a_cancellation_that_comes_too_late_becomes_an_unload() -> None:
    cancelled = run(loading(), NodeInput.UNLOAD_REQUESTED)
    assert cancelled.actions == (NodeAction.SEND_CANCEL,)
    result = run(cancelled.record, NodeInput.LOADED, attempt=1, unique_id=7)
    assert result.record.state is NodeState.UNLOADING
    assert result.actions == (NodeAction.SEND_UNLOAD,)


def test_an_unwanted_node_does_not_come_back_with_its_container() -> None:
    record = run(loaded(), NodeInput.UNLOAD_REQUESTED).record
    record = run(record, NodeInput.CONTAINER_LOST).record
    assert record.state is NodeState.UNLOADED
    assert not run(record, NodeInput.CONTAINER_READY).actions


def test_a_node_that_its_container_unloaded_comes_back_with_the_next() -> None:
    record = run(loaded(), NodeInput.UNLOADED, attempt=1, unique_id=7).record
    record = run(record, NodeInput.CONTAINER_LOST).record
    assert run(record, NodeInput.CONTAINER_READY).actions == (NodeAction.SEND_LOAD,)


def crashed() -> Step:
    return run(loaded(), NodeInput.CRASHED, attempt=1, unique_id=7)


def test_a_crash_is_followed_up_once() -> None:
    assert crashed().record.state is NodeState.CRASHED
    assert crashed().actions == (NodeAction.FOLLOW_UP,)
    again = run(crashed().record, NodeInput.CRASHED, attempt=1, unique_id=7)
    assert again.record == crashed().record
    assert not again.actions


@pytest.mark.parametrize("said", [NodeInput.LOAD_FAILED, NodeInput.REJECTED])
def test_a_reload_that_fails_is_followed_up_too(said: NodeInput) -> None:
    reload = run(crashed().record, NodeInput.RELOAD_DUE).record
    assert reload.is_reload
    failed = run(reload, said, attempt=2, unique_id=8)
    assert failed.record.state is NodeState.LOAD_FAILED
    assert NodeAction.FOLLOW_UP in failed.actions
    assert run(failed.record, NodeInput.RELOAD_DUE).actions == (NodeAction.SEND_LOAD,)


@pytest.mark.parametrize("said", [NodeInput.LOAD_FAILED, NodeInput.REJECTED])
def test_a_first_load_that_fails_is_not(said: NodeInput) -> None:
    failed = run(requested(), said, attempt=1)
    assert failed.record.state is NodeState.LOAD_FAILED
    assert NodeAction.FOLLOW_UP not in failed.actions


def test_the_first_load_of_a_new_container_is_no_reload() -> None:
    reload = run(crashed().record, NodeInput.RELOAD_DUE).record
    lost = run(reload, NodeInput.CONTAINER_LOST).record
    assert not run(lost, NodeInput.CONTAINER_READY).record.is_reload


def test_a_reload_that_got_lost_is_sent_anew_as_a_reload() -> None:
    reload = run(crashed().record, NodeInput.RELOAD_DUE).record
    again = run(reload, NodeInput.STATUS_UNKNOWN, attempt=2)
    assert again.actions == (NodeAction.RESEND_LOAD,)
    assert again.record.is_reload


def test_a_node_that_was_given_up_stays_away() -> None:
    record = run(crashed().record, NodeInput.GIVEN_UP).record
    assert record.state is NodeState.GAVE_UP
    for said in NodeInput:
        if said not in {
            NodeInput.UNLOAD_REQUESTED,
            NodeInput.LOAD_REQUESTED,
            NodeInput.RELOAD_REQUESTED,
        }:
            assert run(record, said, attempt=1, unique_id=7).record.state is NodeState.GAVE_UP


@given(
    st.lists(
        st.tuples(st.sampled_from(INPUTS), st.integers(-1, 1), st.integers(0, 3), st.floats(0, 20)),
        max_size=60,
    )
)
def test_no_lie_makes_it_load_without_a_reason(
    words: list[tuple[NodeInput, int, int, float]],
) -> None:
    """A container that says anything at all, also in ways that contradict each other."""
    record, now, resent = NodeRecord(), 0.0, False
    for said, offset, unique_id, seconds in words:
        now += seconds
        before = record
        about = max(record.attempt + offset, 0)
        result = run(record, said, now=now, attempt=about, unique_id=unique_id)
        record = result.record
        if result.ignored:
            assert record == before
            assert not result.actions
        if NodeAction.SEND_LOAD in result.actions:
            assert before.wanted or said in WISHES
            if not before.replaces:
                assert said in {NodeInput.CONTAINER_READY, NodeInput.RELOAD_DUE, *WISHES}
                assert before.state not in WAITING | {NodeState.LOADED}
            resent = False
        if NodeAction.FOLLOW_UP in result.actions:
            assert record.state in {NodeState.CRASHED, NodeState.LOAD_FAILED}
            assert before.state in {NodeState.REQUESTED, NodeState.LOADING, NodeState.LOADED}
            assert about == before.attempt
        if before.state is NodeState.GAVE_UP:
            assert said in WISHES or record.state in {NodeState.GAVE_UP, NodeState.UNLOADED}
        if NodeAction.RESEND_LOAD in result.actions:
            assert said is NodeInput.STATUS_UNKNOWN
            assert about == before.attempt
            assert not resent
            resent = True
        if record.state is NodeState.LOADED and before.state is not NodeState.LOADED:
            assert before.state in WAITING
            assert about == record.attempt == before.attempt


def test_a_question_names_ids_only_where_all_are_known() -> None:
    assert ids_to_ask([Asked(KEYS[0], 1, 7), Asked(KEYS[1], 2, 8)]) == (7, 8)
    assert ids_to_ask([Asked(KEYS[0], 1, 7), Asked(KEYS[1], 2, 0)]) == ()


def test_an_answer_is_read_by_attempt() -> None:
    asked = [
        Asked(KEYS[0], 1, 7),
        Asked(KEYS[1], 2, 8),
        Asked(KEYS[2], 3, 0),
        Asked(KEYS[3], 4, 9),
        Asked(KEYS[4], 5, 0),
    ]
    listed = [
        Listed(unique_id=7, attempt=1, state=NodeStatusState.LOADED),
        Listed(unique_id=8, attempt=99, state=NodeStatusState.LOADED),
        Listed(unique_id=5, attempt=3, state=NodeStatusState.CONSTRUCTING),
        Listed(unique_id=6, attempt=5, state=77),
    ]
    answers = {each.asked.key: each.said for each in read_answer(asked, listed)}
    assert answers == {
        KEYS[0]: NodeInput.STATUS_LOADED,
        KEYS[2]: NodeInput.STATUS_CONSTRUCTING,
        KEYS[3]: NodeInput.STATUS_UNKNOWN,
    }
