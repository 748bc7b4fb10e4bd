"""Settings that differ from the caller's."""

from __future__ import annotations

import pytest

from play_launch.graph_daemon.settings import (
    COMPARED,
    compared_settings,
    differences,
)


def test_the_same_settings_do_not_differ() -> None:
    settings = compared_settings({"ROS_DOMAIN_ID": "5", "PATH": "/bin"}, "rmw_x")
    assert settings == {"ROS_DOMAIN_ID": "5", "RMW_IMPLEMENTATION": "rmw_x"}
    assert differences(settings, settings) == []
    assert differences(settings, {"ROS_DOMAIN_ID": "5"}) == []


def test_a_default_that_is_written_out_does_not_differ() -> None:
    assert differences({}, {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET", "ROS_DOMAIN_ID": "0"}) == []


@pytest.mark.parametrize("name", COMPARED)
def test_every_setting_is_compared_and_named(name: str) -> None:
    (line,) = differences({name: "theirs"}, {name: "ours"})
    assert line == f"{name}: the daemon has theirs, here it is ours"


def test_a_setting_that_only_the_daemon_has_is_reported() -> None:
    (line,) = differences({"CYCLONEDDS_URI": "file"}, {})
    assert line == "CYCLONEDDS_URI: the daemon has file, here it is not set"
