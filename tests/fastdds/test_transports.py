"""Transports of the graph daemon's participant."""

from __future__ import annotations

import pytest

from play_launch.fastdds.transports import choose_transports

FASTDDS = "rmw_fastrtps_cpp"


def test_without_a_profile_it_is_udp() -> None:
    chosen = choose_transports({"HOME": "/"}, ["robot.yaml"], FASTDDS)
    assert chosen is not None
    assert chosen.variables == {"FASTDDS_BUILTIN_TRANSPORTS": "UDPv4"}


@pytest.mark.parametrize(
    ("environment", "files"),
    [
        ({"FASTDDS_BUILTIN_TRANSPORTS": "SHM"}, []),
        ({"FASTDDS_BUILTIN_TRANSPORTS": ""}, []),
        ({"FASTRTPS_DEFAULT_PROFILES_FILE": "profile.xml"}, []),
        ({"FASTDDS_DEFAULT_PROFILES_FILE": "profile.xml"}, []),
        ({}, ["DEFAULT_FASTRTPS_PROFILES.xml"]),
        ({}, ["DEFAULT_FASTDDS_PROFILES.xml"]),
    ],
)
def test_a_users_profile_is_left_alone(environment: dict[str, str], files: list[str]) -> None:
    chosen = choose_transports(environment, files, FASTDDS)
    assert chosen is not None
    assert chosen.variables == {}
    assert chosen.reason.split(" ", 1)[0] in {*environment, *files}


def test_a_profile_that_fast_dds_skips_is_none() -> None:
    chosen = choose_transports(
        {"SKIP_DEFAULT_XML_FILE": "1"}, ["DEFAULT_FASTRTPS_PROFILES.xml"], FASTDDS
    )
    assert chosen is not None
    assert chosen.variables


@pytest.mark.parametrize(
    "environment", [{"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}, {"ROS_LOCALHOST_ONLY": "1"}]
)
def test_where_the_middleware_ignores_the_variable_it_is_not_set(
    environment: dict[str, str],
) -> None:
    chosen = choose_transports(environment, [], FASTDDS)
    assert chosen is not None
    assert chosen.variables == {}
    assert "LOCALHOST" in chosen.reason


def test_the_transports_of_other_middlewares_are_their_own() -> None:
    assert choose_transports({}, [], "rmw_cyclonedds_cpp") is None
