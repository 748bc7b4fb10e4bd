"""The daemon's address is that of ros2cli for every domain."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from play_launch.graph_daemon.contract import DaemonAddress, DomainError, daemon_address, domain_id


@given(st.integers(0, 232))
def test_a_domain_has_a_port_of_its_own(domain: int) -> None:
    address = daemon_address({"ROS_DOMAIN_ID": str(domain)})
    assert address.domain == domain
    assert address.url == f"http://127.0.0.1:{11511 + domain}/ros2cli/"


@pytest.mark.parametrize("environment", [{}, {"ROS_DOMAIN_ID": ""}])
def test_without_a_domain_it_is_0(environment: dict[str, str]) -> None:
    assert daemon_address(environment) == DaemonAddress(0)


@pytest.mark.parametrize("text", ["-1", "233", "x", "1.0", " 1", "+1", "1_0", "٣", "0000001"])
def test_anything_else_is_refused_by_name(text: str) -> None:
    with pytest.raises(DomainError, match="ROS_DOMAIN_ID is a number from 0 to 232"):
        domain_id({"ROS_DOMAIN_ID": text})


def test_a_long_value_is_reported_in_short() -> None:
    with pytest.raises(DomainError) as caught:
        domain_id({"ROS_DOMAIN_ID": "9" * 10_000})
    assert len(str(caught.value)) < 200


@given(st.integers().filter(lambda number: not 0 <= number <= 232))
def test_no_address_for_a_number_that_is_no_domain(domain: int) -> None:
    with pytest.raises(DomainError):
        DaemonAddress(domain)
