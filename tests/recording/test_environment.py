from __future__ import annotations

import json
import sys
from importlib import metadata
from pathlib import Path

import pytest

from play_launch.recording.environment import (
    REDACTED,
    host_facts,
    package_version,
    redacted_environment,
    versions,
)


def test_values_that_may_be_secret_are_not_recorded() -> None:
    environment = {
        "ROS_DOMAIN_ID": "3",
        "PATH": "/bin",
        "AWS_SECRET_ACCESS_KEY": "s1",
        "MY_THING": "s2",
        "ROS_API_TOKEN": "s3",
        "PLAY_LAUNCH_KEY": "s4",
        "CYCLONEDDS_URI": "tcp://user:s5@host/x",
        "PYTHONPATH": "/p",
    }
    found = redacted_environment(environment)
    assert list(found) == sorted(environment)
    kept = {name: value for name, value in found.items() if REDACTED not in value}
    assert kept == {"ROS_DOMAIN_ID": "3", "PATH": "/bin", "PYTHONPATH": "/p"}
    assert found["CYCLONEDDS_URI"] == f"tcp://{REDACTED}@host/x"
    assert not any(f"s{number}" in str(found) for number in range(1, 6))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("CYCLONEDDS_URI", "<CycloneDDS><Security>s0</Security></CycloneDDS>"),
        ("CYCLONEDDS_URI", "file:///etc/dds.xml,<Password>s0</Password>"),
        ("ZENOH_CONFIG_OVERRIDE", 'transport/auth/usrpwd/user="s0"'),
        ("ZENOH_ROUTER_CONFIG_URI", '{password: "s0"}'),
        ("ROS_PWD", "s0"),
        ("ROS_AUTH", "s0"),
        ("ROS_HTTP_AUTHORIZATION", "s0"),
        ("PYTHON_KEYRING_PASS", "s0"),
        ("PYTHON_KEYRING_BACKEND", "s0"),
        ("ROS_DISCOVERY_SERVER", "http://host/x?token=s0"),
        ("ROS_DISCOVERY_SERVER", "host/x?a=1&token=s0"),
        ("ROS_MASTER_URI", "http://host/x?sig=s0&b=2"),
        ("ROS_MASTER_URI", "http://host/x#access=s0"),
        ("ROS_MASTER_URI", "http://:s0@host"),
        ("RMW_OPTIONS", "--user x --password=s0"),
        ("RMW_OPTIONS", "pwd: s0"),
        ("ROS_BEARER", "s0"),
        ("ROS_JWT", "s0"),
        ("ROS_FLEET_PSK", "s0"),
        ("ROS_ACCESSKEY", "s0"),
        ("ROS_OAUTH", "s0"),
        ("ROS_HEADER", "Authorization: Bearer s0"),
        ("ROS_HEADER", "Basic s0s0s0s0"),
        ("ROS_FLEET", "eyJhbGciOiJIUzI1NiJ9.eyJzdWIiOiJzMCJ9.s0s0s0s0"),
        ("ROS_FLEET", "x ghp_s0s0s0s0s0s0s0s0s0s0s0s0s0s0s0s0s0s0"),
        ("ROS_PEM", "-----BEGIN RSA PRIVATE KEY-----\ns0\n"),
    ],
)
def test_secrets_in_variables_that_are_known(name: str, value: str) -> None:
    found = redacted_environment({name: value})[name]
    assert "s0" not in found
    assert REDACTED in found


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("PWD", "/home/me"),
        ("CYCLONEDDS_URI", "file:///etc/dds.xml"),
        ("ZENOH_ROUTER_CHECK_ATTEMPTS", "3"),
        ("ROS_STATIC_PEERS", "a;b:7400"),
        ("ROS_SECURITY_KEYSTORE", "/etc/keys"),
        ("ROS_HEADER", "Basic"),
        ("ROS_ROBOT", "forbearer-of-all"),
        ("AMENT_PREFIX_PATH", "/opt/ros/jazzy:/w/install"),
        ("RCUTILS_CONSOLE_OUTPUT_FORMAT", "[{severity}] {message}"),
    ],
)
def test_what_matters_and_is_no_secret_is_kept(name: str, value: str) -> None:
    assert redacted_environment({name: value}) == {name: value}


def test_the_machine_is_described() -> None:
    facts = host_facts()
    assert json.loads(json.dumps(facts)) == facts
    assert facts["kernel"]
    assert int(facts["memory"]) > 0
    assert "python" in versions()
    assert "mcap" in versions()


def test_versions_are_those_of_the_packages_descriptions() -> None:
    for name, version in versions().items():
        if name != "python":
            assert version == metadata.version(name)


def test_versions_are_found_where_ros_was_built_from_source(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("Some.Thing-1.2rc1.dist-info", "rclpy-7.1.6-py3.12.egg-info", "odd-name-3.egg"):
        (tmp_path / "first" / name).mkdir(parents=True)
    (tmp_path / "second" / "some_thing-9.dist-info").mkdir(parents=True)
    monkeypatch.setattr(sys, "path", [str(tmp_path / name) for name in ("none", "first", "second")])
    found = {name: package_version(name) for name in ("rclpy", "some-thing", "odd-name")}
    assert found == {"rclpy": "7.1.6", "some-thing": "1.2rc1", "odd-name": ""}
