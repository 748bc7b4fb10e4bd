"""Whether machines can find each other's nodes, which is looked at before anything starts."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from play_launch.deploy.machines import reach
from play_launch.deploy.machines.namespaces import missing
from play_launch.deploy.machines.reach import reach_problems
from tests.support.hosts import running, system

if TYPE_CHECKING:
    from collections.abc import Mapping

    from tests.support.hosts import Hosts

needs_hosts = pytest.mark.skipif(bool(missing()), reason=missing())


def report(
    *heard: str, host: str = "", shared_memory: str = "", **variables: str
) -> Mapping[str, Any]:
    return {
        "heard": heard,
        "host": host,
        "shared_memory": shared_memory,
        "variables": variables,
    }


@pytest.mark.parametrize(
    ("one", "other", "expected"),
    [
        (report("b", host="1"), report("a", host="2"), ""),
        (report("b", host="1"), report(host="2"), ""),  # b answers to the address of a
        (report(host="1"), report(host="2"), "no multicast arrives between a and b, so"),
        (report(host="1"), report(host="2", ROS_STATIC_PEERS="a"), ""),
        (report(host="1", RMW_IMPLEMENTATION="rmw_zenoh_cpp"), report(host="2"), ""),
        (report(host="1"), report(host="2", ROS_AUTOMATIC_DISCOVERY_RANGE="OFF"), ""),
        (report("b", host="1"), report("a", host="1"), ""),
        (
            report("b", host="1", shared_memory="7"),
            report("a", host="1", shared_memory="8"),
            "a and b are one computer with two /dev/shm",
        ),
        (
            report("b", host="1", shared_memory="7"),
            report("a", host="1", shared_memory="8", FASTDDS_BUILTIN_TRANSPORTS="UDPv4"),
            "",
        ),
    ],
)
def test_what_keeps_nodes_from_finding_each_other(
    one: Mapping[str, Any], other: Mapping[str, Any], expected: str
) -> None:
    found = reach_problems({"a": one, "b": other}, multicast=True)
    assert [each[: len(expected)] for each in found] == ([expected] if expected else [])
    if "multicast" in expected:
        assert not reach_problems({"a": one, "b": other}, multicast=False)


@pytest.mark.skipif(os.geteuid() != 0, reason="needs root, for another /dev/shm")
def test_two_containers_of_one_computer_tell_that_they_are() -> None:
    asked = {"token": "", "name": "a", "others": [], "seconds": 0, "given": {"ROS_DOMAIN_ID": "x"}}
    command = [sys.executable, "-I", str(Path(reach.__file__)), json.dumps(asked)]
    apart = ["unshare", "-m", "bash", "-c", 'mount -t tmpfs tmpfs /dev/shm; exec "$@"', "bash"]
    reports = {
        name: json.loads(subprocess.run(words, capture_output=True, check=True, timeout=60).stdout)
        for name, words in (("a", command), ("b", [*apart, *command]), ("c", command))
    }
    (found,) = reach_problems(reports | {"c": {**reports["c"], "host": "2"}}, multicast=False)
    assert found.startswith("a and b are one computer")
    assert not reach_problems({"a": reports["a"], "c": reports["c"]}, multicast=False)


@needs_hosts
def test_multicast_that_does_not_arrive_is_said_at_the_start(net: Hosts, tmp_path: Path) -> None:
    with running(net, system(tmp_path, "heard")) as heard:
        assert "multicast" not in heard.loaded().printed()
        heard.stop()
    net.set_multicast("off")
    try:
        with running(net, system(tmp_path, "unheard")) as unheard:
            said = unheard.loaded().printed()
            assert "no multicast arrives between main and h2, main and h3, h2 and h3, so" in said
            assert said.index("no multicast") < said.index('"container"')
            unheard.stop()
    finally:
        net.set_multicast("on")


@needs_hosts
def test_variables_that_only_the_machine_knows_count(net: Hosts, tmp_path: Path) -> None:
    setup = tmp_path / "setup.bash"
    setup.write_text("export ROS_DOMAIN_ID=77\n")
    config = system(tmp_path, "domains", h3=f", setup: [{setup}]")
    lines = config.read_text().splitlines(keepends=True)
    config.write_text("".join(each for each in lines if "ROS_DOMAIN_ID" not in each))
    with running(net, config) as domains:
        assert "the machines have different ROS_DOMAIN_IDs" in domains.loaded().printed()
        domains.stop()
