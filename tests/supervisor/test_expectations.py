"""Whether topics are as expected, by what is measured of them each second."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from play_launch.config.expectations import Durability, Expectation, Reliability
from play_launch.supervisor.expectations import Expectations, Measured, differences

SECOND = 1_000_000_000


def measured(messages: int = 10, **more: Any) -> Measured:
    usual: dict[str, Any] = {
        "topic": "/scan",
        "types": "std_msgs/msg/String",
        "publishers": 1,
        "reliable": 1,
        "latched": 0,
        "messages": messages,
        "gap_ns": SECOND // (messages or 1),
        "span_ns": SECOND,
    }
    return Measured(**usual | more)


def changes(expected: Expectation, *every: Measured) -> list[tuple[int, bool, str]]:
    """Give the changes, each with the number of the measurement from 1 on."""
    judged = Expectations({expected.topic: expected})
    return [
        (number, event.is_met, event.reason)
        for number, each in enumerate(every, 1)
        for event in judged.take(each, number * SECOND)
    ]


def expectation(**what: Any) -> Expectation:
    return Expectation(topic="/scan", **what)


@pytest.mark.parametrize(
    ("what", "found", "text"),
    [
        ({"min_rate": 8.0}, {"messages": 9}, ""),
        ({"min_rate": 8.0}, {"messages": 7}, "7 Hz, expected at least 8 Hz"),
        ({"max_rate": 8.0}, {"messages": 9}, "9 Hz, expected at most 8 Hz"),
        (
            {"max_gap": 0.5},
            {"gap_ns": SECOND * 3 // 4},
            "no message for 0.75 s, expected at most 0.5 s",
        ),
        ({"max_gap": 0.5}, {"publishers": 0, "messages": 0}, "no publisher"),
        ({"publishers": 2}, {}, "1 publisher instead of 2"),
        ({"publishers": 0}, {"publishers": 0}, ""),
        ({"publishers": 0}, {"publishers": 2}, "2 publishers instead of 0"),
        ({"type": "a/msg/B"}, {}, "its type is std_msgs/msg/String, expected a/msg/B"),
        ({"reliability": Reliability.RELIABLE}, {}, ""),
        (
            {"reliability": Reliability.RELIABLE},
            {"publishers": 3},
            "2 publishers offer best_effort",
        ),
        ({"reliability": Reliability.BEST_EFFORT}, {}, "1 publisher offers reliable"),
        ({"durability": Durability.TRANSIENT_LOCAL}, {}, "1 publisher offers volatile"),
        ({"durability": Durability.VOLATILE}, {"latched": 1}, "1 publisher offers transient_local"),
        (
            {"min_rate": 8.0, "type": "a/msg/B"},
            {"messages": 1},
            "its type is std_msgs/msg/String, expected a/msg/B; 1 Hz, expected at least 8 Hz",
        ),
    ],
)
def test_what_differs(what: dict[str, Any], found: dict[str, Any], text: str) -> None:
    latest = measured(**{"messages": 10, **found})
    rate, gap = float(latest.messages), latest.gap_ns / SECOND
    assert "; ".join(differences(expectation(**what), latest, rate, gap)) == text


def test_it_is_met_breaks_and_is_met_again() -> None:
    good, silent = [measured()] * 6, [measured(0, gap_ns=2 * SECOND)] * 6
    first, second, third = changes(expectation(min_rate=5.0), *good, *silent, *good)
    assert first == (3, True, "")
    assert second == (9, False, "0 Hz, expected at least 5 Hz")
    assert third[1:] == (True, "")
    assert 14 < third[0] <= 18


def test_one_second_without_messages_changes_nothing() -> None:
    good = [measured()] * 6
    one = measured(0, gap_ns=SECOND)
    assert len(changes(expectation(min_rate=5.0), *good, one, *good, one, *good)) == 1


def test_what_is_never_there_is_broken_after_a_while_and_not_before() -> None:
    none = [measured(0, publishers=0, types="")] * 30
    assert changes(expectation(min_rate=5.0), *none) == [(10, False, "no publisher")]
    judged = Expectations({"/scan": expectation(min_rate=5.0)})
    assert not [event for each in none for event in judged.take(each, 0, is_up=False)]
    assert [event.is_met for each in none for event in judged.take(each, 0)] == [False]


def test_what_measures_may_be_away_or_held_up() -> None:
    none = [measured(0, publishers=0, types="")] * 5  # found anew, its publishers are not seen yet
    for held_up in (False, True):
        judged = Expectations({"/scan": expectation(min_rate=5.0, max_gap=0.5)})
        events = [event.is_met for each in [measured()] * 5 for event in judged.take(each, 0)]
        if held_up:
            late = measured(1, gap_ns=8 * SECOND, span_ns=8 * SECOND)
            every = [late, *[measured()] * 5]
        else:
            judged.forget("not measured: it was killed")
            (state,) = judged.states
            assert (state.is_met, state.rate) == (None, None)
            assert state.reason == "not measured: it was killed"
            every = [*none, *[measured()] * 5]
        events += [event.is_met for each in every for event in judged.take(each, 0)]
        assert events == [True]
        assert judged.states[0].is_met
        events = [event.is_met for each in none * 3 for event in judged.take(each, 0)]
        assert events == [False]


def test_a_slow_topic_is_measured_over_a_longer_time() -> None:
    # One message in four seconds: no window of three seconds has that rate.
    slow = [measured(int(second % 4 == 0), gap_ns=4 * SECOND) for second in range(60)]
    (only,) = changes(expectation(min_rate=0.2), *slow)
    assert only[1]


def test_other_topics_are_no_matter() -> None:
    assert not changes(expectation(min_rate=5.0), *[measured(topic="/other")] * 20)


@given(st.lists(st.integers(0, 20), max_size=200))
def test_it_never_flaps_and_alternates(rates: list[int]) -> None:
    found = changes(expectation(min_rate=8.0, max_rate=12.0), *map(measured, rates))
    assert all(one[1] is not other[1] for one, other in pairwise(found))
    assert all(other[0] - one[0] >= 2 for one, other in pairwise(found))
    assert all(bool(reason) is not is_met for _, is_met, reason in found)
