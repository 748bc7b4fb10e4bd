"""A library that takes 6 s to open, in containers of all types of the real command."""

from __future__ import annotations

import pytest

from tests.support.replay import Replay, replaying
from tests.support.scenes import container, node, written

TYPES = ("standard", "mt", "isolated", "isolated_mt")
OPENING = 6.0
"""Seconds; twice as long as a container may leave the supervisor without an answer."""


@pytest.fixture(scope="module")
def slow(tmp_path_factory: pytest.TempPathFactory) -> Replay:
    folder = tmp_path_factory.mktemp("slow")
    library = {"package": "play_launch_demo_slow", "plugin": "play_launch_demo::SlowLibrary"}
    containers = [
        container(
            kind,
            node(f"{kind}_talker"),
            {**library, "name": f"{kind}_slow"},
            {**library, "name": f"{kind}_slow_too"},
            container_type=kind,
            loading_timeout="2 s",
        )
        for kind in TYPES
    ]
    names = [f"/{kind}_{name}" for kind in TYPES for name in ("talker", "slow", "slow_too")]
    with replaying(written(folder, containers=containers), folder / "log") as replay:
        replay.read_until_states(dict.fromkeys(names, "loaded"))
    return replay


@pytest.mark.parametrize("kind", TYPES)
def test_no_container_is_taken_for_frozen(slow: Replay, kind: str) -> None:
    assert len(slow.told(name=f"/{kind}", kind="started")) == 1
    assert not slow.told(name=f"/{kind}", kind="exited")


@pytest.mark.parametrize("kind", TYPES)
def test_its_nodes_are_loaded_at_the_first_attempt(slow: Replay, kind: str) -> None:
    for name in ("slow", "slow_too"):
        (loading,) = slow.told(full_node_name=f"/{kind}_{name}", kind="loading")
        (loaded,) = slow.told(full_node_name=f"/{kind}_{name}", kind="loaded")
        assert (loaded["stamp_ns"] - loading["stamp_ns"]) * 1e-9 > OPENING / 2
    assert len(slow.told(full_node_name=f"/{kind}_talker", kind="loaded")) == 1


@pytest.mark.parametrize("kind", TYPES)
def test_it_is_reported_what_they_wait_for(slow: Replay, kind: str) -> None:
    reasons = [each["reason"] for each in slow.told(event="node", node=f"/{kind}_slow")]
    assert any("libplay_launch_demo_slow.so" in reason for reason in reasons), reasons
