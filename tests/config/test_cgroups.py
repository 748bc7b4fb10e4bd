"""`cgroups`, and limits of control groups in `resources`."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from play_launch.config.kinds import parse_cpu_max
from play_launch.config.load import load_config
from play_launch.config.model import ReplayConfig
from play_launch.config.problems import ConfigError
from play_launch.config.resources import CpuMax, GroupLimits, GroupPolicy

SEEDS_FORM = """\
version: 1
composable_node_loading:
  container_type: isolated
  cgroups:
    enabled: true
    base_path: /sys/fs/cgroup/play_launch
    defaults:
      cpu_max: "max 100000"
      cpuset_cpus: "0-7"
    per_node:
      "pointcloud_filter":
        cpu_max: "50000 100000"
        cpuset_cpus: "0-3"
      "/other/detector":
        cpu_max: "200000 100000"
containers:
  - name: main
    resources: {cpu_max: 300 %, memory_max: 1 GiB}
    composable_nodes:
      - {package: demo, plugin: demo::A, name: pointcloud_filter}
      - {package: demo, plugin: demo::A, name: detector, namespace: /other,
         resources: {cpuset: 4-7}}
      - {package: demo, plugin: demo::A}
nodes:
  - command: [x]
    resources: {pids_max: max, memory_high: 400 MB}
"""


def read(folder: Path, text: str) -> ReplayConfig:
    file = folder / "system.yaml"
    file.write_text(text)
    return load_config(file)


def test_defaults_and_limits_of_nodes(tmp_path: Path) -> None:
    config = read(tmp_path, SEEDS_FORM)
    assert config.cgroups == GroupPolicy(enabled=True, base_path=Path("/sys/fs/cgroup/play_launch"))
    (main,) = config.containers
    of_nodes = [node.resources.group for node in main.composable_nodes]
    assert of_nodes == [
        GroupLimits(cpu_max=CpuMax(50_000), cpuset=(0, 1, 2, 3)),
        GroupLimits(cpu_max=CpuMax(200_000), cpuset=(4, 5, 6, 7)),
        GroupLimits(cpu_max=CpuMax(math.inf), cpuset=tuple(range(8))),
    ]
    assert main.resources.group == GroupLimits(cpu_max=CpuMax(300_000), memory_max=2**30)
    assert config.nodes[0].resources.group == GroupLimits(pids_max=math.inf, memory_high=4e8)


def test_what_is_nearer_to_the_node_holds(tmp_path: Path) -> None:
    config = read(
        tmp_path,
        """\
version: 1
composable_node_loading:
  container_type: isolated
  isolation: process
  resources: {cpu_weight: 20, pids_max: 20}
  cgroups:
    defaults: {cpu_weight: 10, io_weight: 10, pids_max: 10, memory_max: 10 MB}
    per_node: {a: {cpu_weight: 30, memory_max: 30 MB}}
containers:
  - name: main
    composable_nodes:
      - {package: demo, plugin: demo::A, name: a, resources: {memory_max: max}}
""",
    )
    (node,) = config.containers[0].composable_nodes
    assert node.resources.group == GroupLimits(
        cpu_weight=30, io_weight=10, pids_max=20, memory_max=math.inf
    )
    assert config.cgroups == GroupPolicy()


@given(st.integers(1, 1024), st.sampled_from(["%", " %"]))
def test_percents_are_of_one_cpu(percent: int, sign: str) -> None:
    limit = parse_cpu_max(f"{percent}{sign}")
    assert (limit.percent, limit.period) == (percent, 100_000)


@given(st.builds(CpuMax, st.just(math.inf) | st.integers(1000, 10**9), st.integers(1000, 10**6)))
def test_what_is_written_is_read(limit: CpuMax) -> None:
    assert parse_cpu_max(str(limit)) == limit


@pytest.mark.parametrize("text", ["50", "0.9 %", "50 % 100", "999 100000", "5000 999", "-5 %", ""])
def test_no_limits(text: str) -> None:
    with pytest.raises(ValueError, match=r"\w"):
        parse_cpu_max(text)


@pytest.mark.parametrize(
    ("resources", "why"),
    [
        ("cpuset: 0-3, cpu_affinity: [4, 5]", "cpu_affinity: none of these CPUs is in its cpuset"),
        ("memory_high: 2 GiB, memory_max: 1 GiB", "memory_high: is never reached"),
    ],
)
def test_limits_that_contradict_one_another_are_refused(
    tmp_path: Path, resources: str, why: str
) -> None:
    text = f"version: 1\nnodes:\n  - {{command: [x], resources: {{{resources}}}}}\n"
    with pytest.raises(ConfigError, match=why):
        read(tmp_path, text)


@pytest.mark.parametrize(
    "resources",
    [
        "cpuset: 0-3, cpu_affinity: [3, 4]",
        "memory_high: 1 GiB, memory_max: 1 GiB",
        "memory_high: max, memory_max: 1 GiB",
    ],
)
def test_limits_of_which_some_holds_are_taken(tmp_path: Path, resources: str) -> None:
    text = f"version: 1\nnodes:\n  - {{command: [x], resources: {{{resources}}}}}\n"
    assert read(tmp_path, text).nodes[0].resources
