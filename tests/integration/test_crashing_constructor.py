"""A constructor that takes its container down is found out within tight restart limits."""

from __future__ import annotations

from pathlib import Path

from tests.support.replay import replaying

CONFIG = """\
version: 1
containers:
  - name: c
    restart: {max_restarts: 1}
    composable_nodes:
      - {package: play_launch_demo, plugin: "play_launch_demo::Talker", name: talker}
      - package: play_launch_demo
        plugin: play_launch_demo::Crasher
        name: bad
        parameters: {in_constructor: true}
      - {package: play_launch_demo, plugin: "play_launch_demo::Listener", name: listener}
"""
AS_IT_SHOULD_BE = {"/talker": "loaded", "/bad": "load failed", "/listener": "loaded"}


def test_with_one_restart_allowed_the_others_are_loaded_in_the_end(tmp_path: Path) -> None:
    config = tmp_path / "c.yaml"
    config.write_text(CONFIG, encoding="utf-8")
    with replaying(config, tmp_path / "logs") as replay:
        replay.read_until_states(AS_IT_SHOULD_BE)
    reason = next(
        event["reason"]
        for event in replay.seen
        if event["event"] == "node" and event["state"] == "load failed"
    )
    assert "times while it was loaded" in reason
    assert "SIGSEGV" in reason
