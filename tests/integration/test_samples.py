"""What users begin with: the samples of configs/, what `init` writes, and what the README shows."""

from __future__ import annotations

import re
import shlex
import signal
import subprocess
from pathlib import Path

import pytest

from tests.support.loopback_network import permitted
from tests.support.replay import alive, replaying, run
from tests.support.waiting import until

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
    """Add to `found` what exists after an event."""
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


def test_it_checks_clean_replays_and_is_never_overwritten(tmp_path: Path) -> None:
    assert run("init", cwd=tmp_path).returncode == 0
    checked = run("check", "robot.yaml", cwd=tmp_path)
    assert checked.returncode == 0, checked.stderr
    with replaying(tmp_path / "robot.yaml", tmp_path / "log", "rate:=50.0") as replay:
        replay.read_until_states({"/talker": "loaded", "/listener": "loaded"})
    (tmp_path / "robot.yaml").write_text("mine")
    (tmp_path / "of FILE").mkdir()
    assert run("init", "of FILE/SCHEMA.yaml", cwd=tmp_path).returncode == 0
    first, *others = (tmp_path / "of FILE" / "SCHEMA.yaml").read_text().splitlines()
    assert first.endswith("/config.schema.json")
    assert "#     play-launch replay SCHEMA.yaml" in "\n".join(others)
    again = run("init", "robot.yaml", cwd=tmp_path)
    assert again.returncode == 2
    assert "is there already" in again.stderr
    assert (tmp_path / "robot.yaml").read_text() == "mine"


README = (ROOT / "README.md").read_text(encoding="utf-8")


def example() -> str:
    (found,) = re.findall(r"```yaml\n(.*?)```", README, flags=re.DOTALL)
    return str(found)


def check(folder: Path, text: str) -> subprocess.CompletedProcess[str]:
    (folder / "robot.yaml").write_text(text, encoding="utf-8")
    return run("check", "robot.yaml", cwd=folder)


def test_the_configuration_is_valid(tmp_path: Path) -> None:
    result = check(tmp_path, example())
    assert result.returncode == 0, result.stdout + result.stderr


def test_the_mistake_is_told_as_shown(tmp_path: Path) -> None:
    (shown,) = re.findall(r"```\n(robot\.yaml:.*?)\n```", README, flags=re.DOTALL)
    result = check(tmp_path, example().replace("{rate: 10.0}", "{rate: [10.0, 5]}"))
    assert result.returncode == 2
    assert shown in result.stdout + result.stderr


def test_the_files_it_names_are_there() -> None:
    for name in re.findall(r"\]\(([^)#:]+)\)", README):
        assert (ROOT / name).is_file(), name


def without_numbers(text: str) -> str:
    """What is the same each time: words, and how wide the columns of words are."""
    lines = text.splitlines()
    kept = [re.sub(r"\s*[\d.,]+( (s|min|h|%|k?MB|GB))?|\s+", " ", line[25:]) for line in lines]
    return "\n".join(line[:25] + rest for line, rest in zip(lines, kept, strict=True))


def test_commands_for_a_running_session_print_what_is_shown(tmp_path: Path) -> None:
    (shown,) = re.findall(r"```\n(\$ play-launch ps .*?)\n```", README, flags=re.DOTALL)
    examples = re.findall(r"^\$ play-launch (.*)\n((?:[^$\n].*\n?)+)", shown, flags=re.MULTILINE)
    assert len(examples) == 2
    demo = ROOT / "configs" / "demo.yaml"
    with replaying(demo, tmp_path / "logs", "-q", "--duration", "600s") as replay:

        def printed_by(line: str) -> str:
            return replay.ask(*shlex.split(line)).stdout

        until(lambda: printed_by("wait") != "", "the demo")
        # What its processes take is measured a moment later.
        until(lambda: "%" in printed_by("ps /chat"), "a sample")
        for line, printed in examples:
            assert without_numbers(printed_by(line)) == without_numbers(printed)
