"""Who is warned that a node may keep locks of its container for long."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from play_launch.config.load import parse_config
from play_launch.config.model import ContainerConfig
from play_launch.runtime.groups import stalls


def container(*resources: dict[str, Any], **more: str) -> ContainerConfig:
    nodes = [
        {"package": "a", "plugin": "a::A", "name": f"n{number}", "resources": each}
        for number, each in enumerate(resources)
    ]
    box = {"name": "box", "container_type": "isolated", "composable_nodes": nodes, **more}
    text = json.dumps({"version": 1, "containers": [box]})
    (found,) = parse_config(text.encode(), Path("a.yaml")).containers
    return found


def test_a_low_quota_is_reported_with_the_longest_wait() -> None:
    ((name, why),) = stalls(container({"cpu_max": "10 %"}, {"cpu_max": "20 %"}))
    assert name == "/n0"
    assert why.startswith("cpu_max gives it 10 % of a CPU")
    assert "which wait for up to 90 ms; fix: " in why
    (short,) = stalls(container({"cpu_max": "1000 10000"}))
    assert "up to 9 ms" in short[1]


@given(st.integers(1, 10_000), st.integers(1, 10_000))
def test_weights_that_are_far_apart_are_reported(one: int, other: int) -> None:
    weights = {"/n0": one, "/n1": other}
    found = dict(stalls(container(*({"cpu_weight": each} for each in weights.values()))))
    heaviest = max(one, other, 100)
    assert found.keys() == {name for name, each in weights.items() if heaviest >= 1000 * each}
    for name, why in found.items():
        assert f"cpu_weight {weights[name]} beside {heaviest}" in why


@pytest.mark.parametrize(
    "more", [{"isolation": "process"}, {"container_type": "isolated_mt", "isolation": "process"}]
)
def test_who_has_memory_of_its_own_stalls_nobody(more: dict[str, str]) -> None:
    assert not list(stalls(container({"cpu_max": "5 %"}, {"cpu_weight": 1}, **more)))
