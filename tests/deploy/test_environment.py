"""Which variables of a shell a unit carries."""

from __future__ import annotations

from play_launch.deploy.environment import carried

SHELL = {
    "PATH": "/opt/ros/jazzy/bin:/usr/bin",
    "AMENT_PREFIX_PATH": "/opt/ros/jazzy",
    "ROS_DOMAIN_ID": "7",
    "RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp",
    "CYCLONEDDS_URI": "<CycloneDDS><Domain/></CycloneDDS>",
    "PLAY_LAUNCH_LOG_DIR": "/var/log/robot",
    "SSH_AUTH_SOCK": "/tmp/agent",
    "LS_COLORS": "x",
    "ROBOT": "spot",
    "HUB_TOKEN": "abc",
    "ROS_BELL": "\x07",
}


def test_ros_and_what_the_configuration_takes_are_carried() -> None:
    found = carried(SHELL, {"ROBOT": "spot", "HUB_TOKEN": "abc", "UNSET": None, "LS_COLORS": None})
    assert set(found.values) == {
        "PATH",
        "AMENT_PREFIX_PATH",
        "ROS_DOMAIN_ID",
        "RMW_IMPLEMENTATION",
        "CYCLONEDDS_URI",
        "PLAY_LAUNCH_LOG_DIR",
        "ROBOT",
    }
    assert found.values["CYCLONEDDS_URI"] == SHELL["CYCLONEDDS_URI"]
    assert found.secrets == ("HUB_TOKEN",)
    assert found.impossible == ("ROS_BELL",)


def test_a_password_in_a_configuration_of_a_middleware_is_a_secret() -> None:
    shell = {"CYCLONEDDS_URI": "<Security password=abc>", "ROS_URL": "http://a:b@c/"}
    assert carried(shell, {}).secrets == ("CYCLONEDDS_URI", "ROS_URL")
