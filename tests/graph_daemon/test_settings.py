"""Transports of the daemon, and settings that differ from the caller's."""

from __future__ import annotations

import pytest

from play_launch.graph_daemon.settings import (
    COMPARED,
    choose_transports,
    compared_settings,
    differences,
)


def test_without_a_profile_it_is_udp() -> None:
    chosen = choose_transports({"HOME": "/"}, ["robot.yaml"])
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
    chosen = choose_transports(environment, files)
    assert chosen.variables == {}
    assert chosen.reason.split(" ", 1)[0] in {*environment, *files}


def test_a_profile_that_fast_dds_skips_is_none() -> None:
    chosen = choose_transports({"SKIP_DEFAULT_XML_FILE": "1"}, ["DEFAULT_FASTRTPS_PROFILES.xml"])
    assert chosen.variables


def test_the_same_settings_do_not_differ() -> None:
    settings = compared_settings({"ROS_DOMAIN_ID": "5", "PATH": "/bin"}, "rmw_x")
    assert settings == {"ROS_DOMAIN_ID": "5", "RMW_IMPLEMENTATION": "rmw_x"}
    assert differences(settings, settings) == []
    assert differences(settings, {"ROS_DOMAIN_ID": "5"}) == []


def test_a_default_that_is_written_out_does_not_differ() -> None:
    assert differences({}, {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET", "ROS_DOMAIN_ID": "0"}) == []


@pytest.mark.parametrize(
    "environment", [{"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}, {"ROS_LOCALHOST_ONLY": "1"}]
)
def test_where_the_middleware_ignores_the_variable_it_is_not_set(
    environment: dict[str, str],
) -> None:
    chosen = choose_transports(environment, [])
    assert chosen.variables == {}
    assert "LOCALHOST" in chosen.reason


@pytest.mark.parametrize("name", COMPARED)
def test_every_setting_is_compared_and_named(name: str) -> None:
    (line,) = differences({name: "theirs"}, {name: "ours"})
    assert line == f"{name}: the daemon has theirs, here it is ours"


def test_a_setting_that_only_the_daemon_has_is_told() -> None:
    (line,) = differences({"CYCLONEDDS_URI": "file"}, {})
    assert line == "CYCLONEDDS_URI: the daemon has file, here it is not set"
