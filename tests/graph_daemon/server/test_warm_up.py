"""When the graph is known well enough to be asked, and who is missing."""

from __future__ import annotations

import socket

import pytest
from hypothesis import given
from hypothesis import strategies as st

from play_launch.graph_daemon.server.warm_up import (
    LONGEST_WARM_UP,
    MOST,
    QUIET,
    WINDOW,
    Pulse,
    count_participants,
    participants_here,
)

moments = st.lists(st.floats(0, 20), max_size=40).map(sorted)


def test_it_is_warm_after_a_pause_if_nobody_is_missing() -> None:
    pulse = Pulse(0.0)
    pulse.change(0.25)
    assert not pulse.is_warm(0.25 + QUIET / 2, complete=True)
    assert pulse.is_warm(0.25 + QUIET, complete=True)
    assert not pulse.is_warm(0.25 + QUIET, complete=False)


def test_it_is_warm_at_the_latest_after_a_while() -> None:
    pulse = Pulse(10.0)
    assert not pulse.is_warm(10.0 + LONGEST_WARM_UP - 0.01, complete=False)
    assert pulse.is_warm(10.0 + LONGEST_WARM_UP, complete=False)


@given(moments, st.floats(0, 20))
def test_who_looks_when_due_sees_it_get_warm_in_time(changes: list[float], start: float) -> None:
    """With changes at any time, looking again as told ends at the deadline, in few looks."""
    pulse = Pulse(start)
    now, looks = start, 0
    pending = [start + change for change in changes]
    while not pulse.is_warm(now, complete=False):
        following = pulse.look_again_at(now)
        assert following > now
        now = following
        looks += 1
        while pending and pending[0] <= now:
            pulse.change(pending.pop(0))
    assert now <= pulse.deadline + 0.2
    assert looks <= 60


@given(moments)
def test_the_rate_is_that_of_the_last_seconds(changes: list[float]) -> None:
    pulse = Pulse(0.0)
    for change in changes:
        pulse.change(change)
    now = 20.0
    recent = [change for change in changes if change > now - WINDOW]
    assert pulse.rate(now) == pytest.approx(len(recent) / WINDOW)
    assert pulse.quiet_for(now) == pytest.approx(now - (changes[-1] if changes else 0.0))


def test_a_storm_is_remembered_for_a_while_only() -> None:
    pulse = Pulse(0.0)
    for number in range(10_000):
        pulse.change(number * 0.05)
    assert pulse.rate(10_000 * 0.05) == pytest.approx(20, rel=0.1)
    assert len(pulse._changes) <= WINDOW / 0.05 + 1


HEADER = "   sl  local_address rem_address   st tx_queue rx_queue tr tm->when retrnsmt   uid"


def table(ports: list[int]) -> str:
    lines = [
        f"  {number}: 00000000:{port:04X} 00000000:0000 07 00000000:00000000 00:00000000 00000000"
        for number, port in enumerate(ports)
    ]
    return "\n".join([HEADER, *lines])


@given(st.integers(0, 230), st.sets(st.integers(0, MOST - 1)))
def test_each_participant_of_the_domain_counts_once(domain: int, indices: set[int]) -> None:
    first = 7400 + 250 * domain
    ports = [first + 10 + 2 * index for index in indices]
    # Its ports for data, the port for multicast, and a participant of another domain.
    others = [port + 1 for port in ports] + [first, first + 260, 53]
    assert count_participants(table(ports * 2 + others), domain) == len(indices)


@given(st.text())
def test_what_is_no_table_holds_nobody(text: str) -> None:
    assert count_participants(text, 0) == 0


def test_a_socket_of_this_machine_is_seen(other_domain: int) -> None:
    before = participants_here(other_domain)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as mine:
        mine.bind(("127.0.0.1", 7400 + 250 * other_domain + 10 + 2 * 77))
        assert participants_here(other_domain) == before + 1
    assert participants_here(other_domain) == before
