"""What a configuration asks of its unit."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from play_launch.config.load import parse_config
from play_launch.config.model import ReplayConfig
from play_launch.deploy.needs import settings, stop_seconds

SLEEP: dict[str, Any] = {"command": ["sleep", "9"]}


def system(**keys: Any) -> ReplayConfig:
    return parse_config(json.dumps({"version": 1, **keys}).encode(), Path("/etc/robot.yaml"))


def process(**resources: Any) -> ReplayConfig:
    return system(nodes=[{**SLEEP, "name": "p", "resources": resources}])


def lines(config: ReplayConfig, *, for_user: bool = False) -> list[str]:
    return [line for each in settings(config, for_user=for_user) for line in each.lines]


USUAL = ["LimitNOFILE=4096:524288", "TasksMax=infinity"]
ISOLATED = {
    "container_type": "isolated",
    "name": "c",
    "resources": {"lock_memory": True},
    "core_dumps": True,
    "composable_nodes": [
        {
            "package": "p",
            "plugin": "p::N",
            "name": "n",
            "resources": {"scheduler": {"policy": "fifo", "priority": 80}},
        }
    ],
}


@pytest.mark.parametrize(
    ("config", "wanted"),
    [
        (process(), []),
        (process(nice=5, cpu_affinity=[0], oom_score_adj=300, io_priority="idle"), []),
        (process(scheduler={"policy": "batch"}, rlimits={"core": 0, "cpu": "1 h"}), []),
        (process(nice=-5), ["LimitNICE=-6"]),
        (process(nice=-20), ["LimitNICE=-20"]),
        (process(rlimits={"nice": -7}), ["LimitNICE=-8"]),
        (process(rlimits={"nice": 7}), []),
        (process(scheduler={"policy": "rr", "priority": 99}), ["LimitRTPRIO=99"]),
        (process(rlimits={"rtprio": 30}), ["LimitRTPRIO=31"]),
        (process(rlimits={"memlock": "1 GB"}), ["LimitMEMLOCK=infinity"]),
        (process(rlimits={"nproc": 9000}), ["LimitNPROC=infinity"]),
        (process(io_priority="realtime:3"), ["AmbientCapabilities=CAP_SYS_NICE"]),
        (process(oom_score_adj=-500), ["OOMScoreAdjust=-500"]),
        (
            system(containers=[ISOLATED]),
            ["LimitRTPRIO=81", "LimitMEMLOCK=infinity", "LimitCORE=infinity"],
        ),
    ],
)
def test_limits_follow_from_resources(config: ReplayConfig, wanted: list[str]) -> None:
    # The supervisor itself runs ahead of what it starts; nodes with priorities need more.
    ahead = [] if "RTPRIO" in str(wanted) else ["LimitRTPRIO=1"]
    assert lines(config) == [*USUAL, *ahead, *wanted]


def test_open_files_have_room() -> None:
    assert "LimitNOFILE=4096:1000000" in lines(process(rlimits={"nofile": 1_000_000}))
    assert "LimitNOFILE=4096:524288" in lines(process(rlimits={"nofile": 100}))
    assert "LimitNOFILE=4096:infinity" in lines(process(rlimits={"nofile": "unlimited"}))


def test_a_manager_of_a_user_gives_no_rights_and_the_unit_says_so() -> None:
    config = process(nice=-5, io_priority="realtime", oom_score_adj=-500)
    found = settings(config, for_user=True)
    assert lines(config, for_user=True) == [*USUAL, "LimitNICE=-6"]
    why = " ".join(each.why for each in found)
    for word in ("systemctl edit user@.service", "CAP_SYS_NICE", "CAP_SYS_RESOURCE"):
        assert word in why


def test_a_stop_takes_as_long_as_its_levels_and_those_who_wait_for_each_other() -> None:
    limits = {"ask": "1 s", "sigint": "2 s", "sigterm": "3 s"}
    # 5 s for SIGKILL, 10 s to close the recording.
    assert stop_seconds(system(stop=limits, nodes=[{**SLEEP, "name": "a"}])) == 21
    chain = [
        {**SLEEP, "name": "a"},
        {**SLEEP, "name": "b", "depends_on": ["a"]},
        {**SLEEP, "name": "c", "depends_on": ["b"]},
        {**SLEEP, "name": "d", "depends_on": ["a"]},
    ]
    assert stop_seconds(system(stop=limits, nodes=chain)) == 3 * 11 + 10


@given(st.lists(st.integers(0, 5), min_size=1, max_size=6))
def test_generations_are_the_longest_chain(levels: list[int]) -> None:
    nodes = []
    for number, level in enumerate(levels):
        before = [f"p{other}" for other in range(number) if levels[other] < level]
        nodes.append({**SLEEP, "name": f"p{number}", "depends_on": before})
    depth: dict[int, int] = {}
    for number, level in enumerate(levels):
        chain = [depth[other] for other in range(number) if levels[other] < level]
        depth[number] = 1 + max(chain, default=0)
    stop = {"ask": "1 s", "sigint": "1 s", "sigterm": "1 s"}
    assert stop_seconds(system(stop=stop, nodes=nodes)) == 8 * max(depth.values()) + 10
