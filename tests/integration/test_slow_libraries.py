"""A library that takes 6 s to open, in containers of all types of the real command."""

from __future__ import annotations

from typing import Any

import pytest

from tests.support.replay import Replay, replaying

TYPES = ("standard", "mt", "isolated", "isolated_mt")
OPENING = 6.0
"""Seconds; twice as long as a container may leave the supervisor without an answer."""

CONTAINER = """\
  - name: {kind}
    container_type: {kind}
    loading_timeout: 2 s
    composable_nodes:
      - package: play_launch_demo
        plugin: play_launch_demo::Talker
        name: {kind}_talker
      - package: play_launch_demo_slow
        plugin: play_launch_demo::SlowLibrary
        name: {kind}_slow
      - package: play_launch_demo_slow
        plugin: play_launch_demo::SlowLibrary
        name: {kind}_slow_too
"""


@pytest.fixture(scope="module")
def slow(tmp_path_factory: pytest.TempPathFactory) -> Replay:
    folder = tmp_path_factory.mktemp("slow")
    config = folder / "slow.yaml"
    containers = "".join(CONTAINER.format(kind=kind) for kind in TYPES)
    config.write_text(f"version: 1\ncontainers:\n{containers}", encoding="utf-8")
    missing = {f"/{kind}_{node}" for kind in TYPES for node in ("talker", "slow", "slow_too")}

    def complete(event: dict[str, Any]) -> bool:
        if event["event"] == "component" and event["kind"] == "loaded":
            missing.discard(event["full_node_name"])
        return not missing

    with replaying(config, folder / "log") as replay:
        replay.read_until(complete, f"{missing} loaded")
    return replay


def events(replay: Replay, event: str, kind: str, name: str) -> list[dict[str, Any]]:
    key = {"component": "full_node_name", "process": "name"}[event]
    return [
        each
        for each in replay.seen
        if (each["event"], each.get("kind"), each.get(key)) == (event, kind, name)
    ]


@pytest.mark.parametrize("kind", TYPES)
def test_no_container_is_taken_for_frozen(slow: Replay, kind: str) -> None:
    assert len(events(slow, "process", "started", f"/{kind}")) == 1
    assert not events(slow, "process", "exited", f"/{kind}")


@pytest.mark.parametrize("kind", TYPES)
def test_its_nodes_are_loaded_at_the_first_attempt(slow: Replay, kind: str) -> None:
    for node in ("slow", "slow_too"):
        (loading,) = events(slow, "component", "loading", f"/{kind}_{node}")
        (loaded,) = events(slow, "component", "loaded", f"/{kind}_{node}")
        assert (loaded["stamp_ns"] - loading["stamp_ns"]) * 1e-9 > OPENING / 2
    (neighbour,) = events(slow, "component", "loaded", f"/{kind}_talker")
    assert neighbour["full_node_name"] == f"/{kind}_talker"


@pytest.mark.parametrize("kind", TYPES)
def test_it_is_reported_what_they_wait_for(slow: Replay, kind: str) -> None:
    reasons = [
        each["reason"]
        for each in slow.seen
        if each["event"] == "node" and each["node"] == f"/{kind}_slow"
    ]
    assert any("libplay_launch_demo_slow.so" in reason for reason in reasons), reasons
