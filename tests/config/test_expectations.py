"""`expect`: read, refused with the place, split over machines."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from play_launch.config.expectations import Expectation, Reliability
from play_launch.config.load import parse_config
from play_launch.config.machines import part_of
from play_launch.config.model import ReplayConfig
from play_launch.config.problems import ConfigError

NODES = "nodes: [{name: a, command: [x], depends_on: [{expect: scan}]}]\n"


def read(text: str) -> ReplayConfig:
    return parse_config(f"version: 1\n{text}".encode(), Path("/robot/system.yaml"))


def test_what_can_be_expected() -> None:
    text = "expect:\n  scan: {type: a/B, min_rate: 8 Hz, max_gap: 500 ms, reliability: reliable}\n"
    assert read(text + NODES).expect == {
        "/scan": Expectation(
            topic="/scan",
            type="a/msg/B",
            min_rate=8.0,
            max_rate=math.inf,
            max_gap=0.5,
            reliability=Reliability.RELIABLE,
        )
    }


def test_nodes_name_topics_as_they_know_them() -> None:
    config = read("""\
machines: {main: {local: true}, vision: {}}
containers:
  - name: eyes
    machine: vision
    composable_nodes:
      - package: demo
        plugin: demo::Lidar
        name: lidar
        namespace: /front
        remappings: {points: /cloud, ~/state: health}
        expect:
          points: {min_rate: 9}
          scan: {min_rate: 8}
          ~/state: {min_rate: 7}
          ~/raw: {min_rate: 6}
          /tf: {min_rate: 5, machine: main}
nodes:
  - {name: planner, command: [x], depends_on: [{expect: /cloud}], expect: {path: {min_rate: 4}}}
  - {command: [y], remappings: {~/in: a, out: b}, expect: {out: {min_rate: 3}}}
""")
    assert {(each.topic, each.machine, each.min_rate) for each in config.expect.values()} == {
        ("/cloud", "vision", 9),
        ("/front/scan", "vision", 8),
        ("/front/health", "vision", 7),
        ("/front/lidar/raw", "vision", 6),
        ("/tf", "main", 5),
        ("/path", "main", 4),
        ("/b", "main", 3),
    }


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (
            "scan: {min_rate: 8 Hz, max_rate: 5}",
            "3:36: expect.scan.max_rate: is less",
        ),
        ("scan: {}", "3:9: expect.scan: nothing is expected of it; give type, min_rate, max_rate"),
        ("'b b': {max_gap: 1 s}", '3:3: expect."b b": the topic name "b b" holds " "'),
        ("scan: {reliability: no}", 'expected reliable or best_effort, given "no"'),
        ("scan: {min_rate: fast}", 'expected a rate such as 10 or 10 Hz, given "fast"'),
        ("scan: {min_rate: true}", "expected a rate such as 10 or 10 Hz"),
        ("scan: {max_rate: .inf}", "expected a rate such as 10 or 10 Hz"),
        ("scan: {publishers: -1}", "publishers"),
        ("scan: {min_rate: 1, machine: moon}", 'there is no machine "moon"'),
        ("scan: {rate: 1}", "did you mean"),
        ("scan: {min_rate: 1}\n  /scan: {min_rate: 1}", "/scan is given twice"),
        ("/other: {min_rate: 1}", "nothing is expected of /scan; add it to expect"),
    ],
)
def test_mistakes_are_found(text: str, problem: str) -> None:
    with pytest.raises(ConfigError) as refused:
        read(f"expect:\n  {text}\n{NODES}")
    assert problem in refused.value.for_people()


def test_each_machine_measures_its_topics_and_is_asked_for_them() -> None:
    config = read(
        "machines: {main: {local: true}, arm: {ssh: arm}}\n"
        f"expect: {{scan: {{min_rate: 1, machine: arm}}, /map: {{publishers: 1}}}}\n{NODES}"
        "containers: [{name: c, machine: arm}]\n"
    )
    main, arm = part_of(config, "main"), part_of(config, "arm")
    assert (list(main.expect), list(arm.expect)) == (["/map"], ["/scan"])
    (waits,) = main.start_rules["/a"].dependencies
    assert str(waits) == "/scan to be as expected on arm"
    (asked,) = [each for rule in arm.start_rules.values() for each in rule.dependencies]
    assert asked.subject == "/scan"
