"""The machines of a configuration, and their parts."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from play_launch.config.dependency import Condition
from play_launch.config.load import parse_config
from play_launch.config.machines import (
    AWAITED_ELSEWHERE,
    discovery_problems,
    part_of,
    stopped_after,
    used_machines,
)
from play_launch.config.model import ReplayConfig
from play_launch.config.problems import ConfigError

MACHINES = """\
version: 1
machines:
  main: {local: true}
  vision: {ssh: robot@vision, setup: [~/ws/setup.bash], environment: {CUDA: "1", SHARED: v}}
  arm: {service: none, on_lost: {stop_after: 30 s}, copy: [maps/], optional: true}
environment: {SHARED: all, ONLY: all}
"""


def read(text: str, machines: str = MACHINES) -> ReplayConfig:
    return parse_config((machines + text).encode(), Path("/robot/system.yaml"))


def problems(text: str, machines: str = MACHINES) -> str:
    with pytest.raises(ConfigError) as refused:
        read(text, machines)
    return refused.value.for_people()


def node(name: str, machine: str = "", more: str = "") -> str:
    place = f", machine: {machine}" if machine else ""
    return f"  - {{name: {name}, command: [sleep, '9']{place}{more}}}\n"


def test_what_names_no_machine_runs_on_the_local_one() -> None:
    config = read("nodes:\n" + node("a") + node("b", "arm"))
    assert [each.machine for each in config.nodes] == ["main", "arm"]
    assert config.machines["arm"].copy == (Path("/robot/maps"),)
    assert config.machines["arm"].stop_after == 30.0
    assert used_machines(config) == ["main", "arm"]


def test_the_key_machine_of_the_file_is_for_those_that_name_none() -> None:
    config = read("machine: arm\nnodes:\n" + node("a") + node("b", "vision"))
    assert [each.machine for each in config.nodes] == ["arm", "vision"]


def test_an_inclusion_has_a_machine(tmp_path: Path) -> None:
    (tmp_path / "part.yaml").write_text("version: 1\nnodes:\n" + node("a") + node("b", "arm"))
    text = f"include: [{{file: {tmp_path}/part.yaml, machine: vision}}]\nnodes:\n" + node("c")
    config = read(text)
    assert {each.name: each.machine for each in config.nodes} == {
        "a": "vision",
        "b": "arm",
        "c": "main",
    }


def test_variables_of_a_machine_stand_between_those_of_the_system_and_the_entry() -> None:
    config = read("nodes:\n" + node("a", "vision", ", environment: {CUDA: '2'}"))
    assert dict(config.nodes[0].environment) == {"SHARED": "v", "ONLY": "all", "CUDA": "2"}


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (node("a", "vison"), 'there is no machine "vison"; did you mean vision?'),
        (node("a", "x"), "declared are main, vision, arm"),
    ],
)
def test_unknown_machines_are_reported_with_their_place(text: str, expected: str) -> None:
    found = problems("nodes:\n" + text)
    assert expected in found
    assert "/robot/system.yaml:8:" in found


@pytest.mark.parametrize(
    ("machines", "expected"),
    [
        ("{a: {local: true}, b: {local: true}}", "only one machine is local, and a is"),
        ("{a: {local: true, ssh: x}}", "is for machines that ssh reaches"),
        ("{a-b: {}}", "a machine is named by letters"),
        ("{a: {servise: none}}", 'unknown key "servise"'),
        ("{a: {lost_after: 0 s}}", "machines.a.lost_after"),
        ("[a]", "expected a mapping"),
        ("{a: {}}", "the key machine is missing, because no machine is local"),
    ],
)
def test_mistakes_in_machines(machines: str, expected: str) -> None:
    found = problems("nodes:\n" + node("a"), f"version: 1\nmachines: {machines}\n")
    assert expected.replace('"', "") in found.replace("'", "").replace('"', "")


def test_without_machines_there_is_none_to_name() -> None:
    assert "declare it in machines" in problems("nodes:\n" + node("a", "x"), "version: 1\n")


def test_a_condition_on_a_unit_elsewhere_stays_with_its_machine() -> None:
    config = read("nodes:\n" + node("a", "arm") + node("b", "main", ", depends_on: [a]"))
    (dependency,) = part_of(config, "main").start_rules["/b"].dependencies
    assert dependency.machine == "arm"
    assert str(dependency) == "/a to be started on arm"
    (asked,) = part_of(config, "arm").start_rules[AWAITED_ELSEWHERE].dependencies
    assert (asked.condition, asked.unit) == (Condition.STARTED, "/a")
    assert stopped_after(config)["arm"] == {"main"}


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (
            "environment: {ROS_AUTOMATIC_DISCOVERY_RANGE: LOCALHOST}\n",
            ["main: ROS_A", "arm: ROS_A"],
        ),
        ("environment: {ROS_AUTOMATIC_DISCOVERY_RANGE: SUBNET}\n", []),
        ("discovery: {by: peers}\n", []),
    ],
)
def test_settings_with_which_machines_find_nothing_of_each_other(
    text: str, expected: list[str]
) -> None:
    machines = MACHINES.replace("environment: {SHARED: all, ONLY: all}\n", text)
    config = read("nodes:\n" + node("a") + node("b", "arm"), machines)
    found = discovery_problems(config, {})
    assert [each[: len(start)] for each, start in zip(found, expected, strict=True)] == expected


def test_peers_reach_no_more_than_32_processes_of_a_machine() -> None:
    nodes = "".join(node(f"n{number}") for number in range(33)) + node("b", "arm")
    (found,) = discovery_problems(read(f"discovery: {{by: peers}}\nnodes:\n{nodes}"), {})
    assert "33 processes" in found


PLACES = st.sampled_from(["main", "vision", "arm"])


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_parts_lose_nothing_and_have_nothing_twice(
    data: st.DataObject,
) -> None:
    count = data.draw(st.integers(1, 8))
    places = [data.draw(PLACES) for _ in range(count)]
    needs = {
        number: data.draw(st.sets(st.integers(0, number - 1), max_size=3)) if number else set()
        for number in range(count)
    }
    text = "nodes:\n" + "".join(
        node(f"n{number}", places[number], f", depends_on: [{', '.join(f'n{i}' for i in on)}]")
        for number, on in needs.items()
    )
    config = read(text)
    parts = {name: part_of(config, name) for name in config.machines}
    names = [each.full_name for part in parts.values() for each in part.members]
    assert sorted(names) == sorted(each.full_name for each in config.members)
    for machine, part in parts.items():
        here = {each.full_name for each in part.members}
        for unit, rule in part.start_rules.items():
            for dependency in rule.dependencies:
                if not dependency.machine:
                    assert dependency.unit in here
                else:
                    assert unit in here
                    asked = parts[dependency.machine].start_rules[AWAITED_ELSEWHERE].dependencies
                    assert dependency.unit in {each.unit for each in asked}
        assert sum(len(r.dependencies) for u, r in part.start_rules.items() if u in here) == sum(
            len(on) for number, on in needs.items() if places[number] == machine
        )
