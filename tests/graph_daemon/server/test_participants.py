"""Participants are counted by the kernel's sockets."""

from __future__ import annotations

import socket

from hypothesis import given
from hypothesis import strategies as st

from play_launch.graph_daemon.server.participants import MOST, count_participants, participants_here

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
