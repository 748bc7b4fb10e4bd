from __future__ import annotations

import itertools

import pytest

from play_launch.core.events import NodeState
from play_launch.core.node_report import NodeReport, report_of
from play_launch.core.node_table import TABLE, WAITING, NodeInput

State, Said, R = NodeState, NodeInput, NodeReport


@pytest.mark.parametrize(
    ("before", "said", "report"),
    [
        (State.LOADING, Said.LOADED, R.LOADED),
        (State.LOADING, Said.STATUS_LOADED, R.CONFIRMED),
        (State.LOADED, Said.STATUS_LOADED, None),
        (State.REQUESTED, Said.STATUS_CONSTRUCTING, R.SLOW),
        (State.LOADING, Said.STATUS_CONSTRUCTING, R.SLOW),
        (State.LOADED, Said.STATUS_CONSTRUCTING, None),
        (State.LOADING, Said.LOAD_FAILED, R.FAILED),
        (State.LOADED, Said.STATUS_UNKNOWN, R.FORGOTTEN),
        (State.REQUESTED, Said.STATUS_UNKNOWN_AGAIN, R.FORGOTTEN),
        (State.LOADED, Said.CRASHED, R.CRASHED),
        (State.CRASHED, Said.GIVEN_UP, R.GAVE_UP),
        (State.LOADED, Said.UNLOADED, R.UNASKED),
        (State.UNLOADING, Said.UNLOADED, R.UNLOADED),
        (State.LOADED, Said.CONTAINER_LOST, R.LOST),
        (State.PENDING, Said.CONTAINER_READY, None),
        (State.UNLOADING, Said.CRASHED, R.CRASHED),
    ],
)
def test_what_a_reader_is_shown(
    before: NodeState, said: NodeInput, report: NodeReport | None
) -> None:
    assert report_of(before, said, TABLE[before][said].state) is report


def test_who_crashes_instead_of_making_room_is_shown_although_another_follows() -> None:
    assert report_of(State.UNLOADING, Said.CRASHED, State.REQUESTED) is R.FAULTED


@pytest.mark.parametrize(("before", "said"), list(itertools.product(NodeState, NodeInput)))
def test_whatever_changes_for_a_reader_is_reported(before: NodeState, said: NodeInput) -> None:
    after = TABLE[before][said].state
    silent = {NodeState.PENDING, *WAITING}
    assert (report_of(before, said, after) is not None) == (
        (after is not before and after not in silent)
        or (said is NodeInput.STATUS_CONSTRUCTING and before in WAITING)
    )
