"""Every sample of configs/ is what its comments say it is."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest

from tests.support.loopback_network import permitted
from tests.support.replay import alive, replaying, run

ROOT = Path(__file__).resolve().parents[2]
CONFIGS = ROOT / "configs"
SAMPLES = sorted(CONFIGS.glob("*.yaml"))
SMALL = {
    "ordinary_nodes": {"/front/pilot", "/front/copilot", "/clock", "/self_test"},
    "parameters": {"/lab", "/arm/echo", "/types"},
    "recording": {"/chat", "/talker", "/listener"},
    "variant": {"/chat", "/monitor", "/talker", "/far_listener"},
}


def up(event: dict[str, object], found: set[str]) -> set[str]:
    """Add to `found` who is there after an event."""
    if event["event"] == "node":
        name, is_up = str(event["node"]), event["state"] == "loaded"
    elif event["event"] == "process":
        name, is_up = str(event["name"]), event["kind"] != "exited"
    else:
        return found
    return found | {name} if is_up else found - {name}


@pytest.mark.parametrize("sample", SAMPLES, ids=lambda sample: sample.stem)
def test_samples_have_no_mistakes(sample: Path) -> None:
    checked = run("check", sample, "--json")
    assert checked.returncode == 0, checked.stdout
    assert sample.read_text(encoding="utf-8").count("#") >= 3, "a sample explains itself"


@pytest.mark.parametrize("name", SMALL)
def test_small_samples_come_up_and_end_by_themselves(name: str, tmp_path: Path) -> None:
    with replaying(CONFIGS / f"{name}.yaml", tmp_path) as replay:
        events = replay.read_all()
    assert replay.process.returncode == 0, events[-1]
    seen = set().union(*(up(each, set()) for each in events))
    assert seen >= SMALL[name]


def test_a_hundred_nodes_come_up_and_stop_clean(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not permitted():
        pytest.skip("this kernel permits no network namespace, and LOCALHOST finds 32 participants")
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")
    sample = CONFIGS / "autoware_scale.yaml"
    with replaying(sample, tmp_path, "--quiet", in_a_network=True) as replay:
        found: set[str] = set()

        def is_up(event: dict[str, object]) -> bool:
            nonlocal found
            found = up(event, found)
            return len(found) == 15 + 54 + 46

        replay.read_until(is_up, "all of its nodes")
        started = replay.descendants()
        assert len(started) >= 15 + 46
        replay.process.send_signal(signal.SIGINT)
        replay.read_all()
    assert replay.process.returncode == 130
    assert not alive(started)
