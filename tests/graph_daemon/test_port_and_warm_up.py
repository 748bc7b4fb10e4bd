"""Decisions without processes: addresses, settings that differ, participants that are counted."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from play_launch.graph_daemon.contract import DaemonAddress, DomainError, daemon_address
from play_launch.graph_daemon.warm_up import (
    MOST,
    count_participants,
)


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
