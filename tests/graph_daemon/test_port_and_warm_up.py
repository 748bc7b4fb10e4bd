"""Decisions without processes: addresses, settings that differ, participants that are counted."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from play_launch.graph_daemon.contract import DaemonAddress, DomainError, daemon_address
from play_launch.graph_daemon.port import COMPARED, compared_settings, differences
from play_launch.graph_daemon.warm_up import (
    LONGEST_WARM_UP,
    MOST,
    QUIET,
    WINDOW,
    Population,
    Pulse,
    count_participants,
)

moments = st.lists(st.floats(0, 20), max_size=40).map(sorted)


@given(st.integers(0, 232))
def test_the_address_of_a_domain_is_that_of_ros2cli(domain: int) -> None:
    address = daemon_address({"ROS_DOMAIN_ID": str(domain)})
    assert address.url == f"http://127.0.0.1:{11511 + domain}/ros2cli/"
    assert daemon_address({}) == daemon_address({"ROS_DOMAIN_ID": ""}) == DaemonAddress(0)


@pytest.mark.parametrize("text", ["-1", "233", "x", "1.0", " 1", "+1", "1_0", "٣", "9" * 10_000])
def test_what_is_no_domain_is_refused_by_name(text: str) -> None:
    with pytest.raises(DomainError, match="ROS_DOMAIN_ID is a number from 0 to 232") as caught:
        daemon_address({"ROS_DOMAIN_ID": text})
    assert len(str(caught.value)) < 200


def test_the_same_settings_do_not_differ() -> None:
    settings = compared_settings({"ROS_DOMAIN_ID": "5", "PATH": "/bin"}, "rmw_x")
    assert settings == {"ROS_DOMAIN_ID": "5", "RMW_IMPLEMENTATION": "rmw_x"}
    assert differences(settings, settings) == []
    assert differences(settings, {"ROS_DOMAIN_ID": "5"}) == []
    assert differences({}, {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET", "ROS_DOMAIN_ID": "0"}) == []


@pytest.mark.parametrize("name", COMPARED)
def test_every_setting_is_compared_and_named(name: str) -> None:
    (line,) = differences({name: "theirs"}, {name: "ours"})
    assert line == f"{name}: the daemon has theirs, here it is ours"


@given(moments)
def test_the_rate_is_that_of_the_last_seconds(changes: list[float]) -> None:
    pulse = Pulse(0.0)
    for change in changes:
        pulse.change(change)
    now = 20.0
    recent = [change for change in changes if change > now - WINDOW]
    last = changes[-1] if changes else 0.0
    assert pulse.rate(now) == pytest.approx(len(recent) / WINDOW)
    assert pulse.quiet_for(now) == pytest.approx(now - last)
    assert pulse.is_quiet(now) == (now - last >= QUIET)
    assert pulse.is_overdue(LONGEST_WARM_UP)


@pytest.mark.parametrize(
    ("participants", "here", "nameless", "complete"),
    [(3, 3, 0, True), (2, 3, 0, False), (3, 3, 1, False), (0, 3, 0, True), (5, 3, 0, True)],
)
def test_missing_participants(
    participants: int, here: int, nameless: int, *, complete: bool
) -> None:
    assert Population(1, participants, here, nameless).is_complete == complete


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
def test_any_other_text_has_no_participants(text: str) -> None:
    assert count_participants(text, 0) == 0
