from __future__ import annotations

import json

from play_launch.recording.facts import REDACTED, host_facts, redacted_environment, versions


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


def test_the_machine_is_described() -> None:
    facts = host_facts()
    assert json.loads(json.dumps(facts)) == facts
    assert facts["kernel"]
    assert int(facts["memory"]) > 0
    assert "python" in versions()
    assert "mcap" in versions()
