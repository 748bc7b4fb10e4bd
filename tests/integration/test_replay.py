"""The main job, run as a user runs it: real containers, real DDS, real signals."""

from __future__ import annotations

import os
import shutil
import signal
import sys
from collections import Counter
from pathlib import Path

import psutil
import pytest
from mcap.reader import make_reader
from std_msgs.msg import String

from tests.support.replay import alive, recorded, replaying
from tests.support.ros import Probe
from tests.support.scenes import container, node, written

ROOT = Path(__file__).resolve().parents[2]
DEMO = ROOT / "configs" / "demo.yaml"
LOADED, UNLOADED, LOADING = 0, 1, 4
PROCESS = 2


def test_the_demo_runs_talks_stops_and_is_recorded(tmp_path: Path) -> None:
    with replaying(DEMO, tmp_path, "--duration", "120s") as replay:
        while len(replay.told(event="component", kind="loaded")) < 8:
            replay.until(event="component", kind="loaded")
        started = replay.descendants()
        with Probe("far_away") as probe:
            texts = [message.data for message in probe.collect(String, "/chatter", count=3)]
        assert all(text.startswith("Hello from one process: ") for text in texts)
        replay.process.send_signal(signal.SIGINT)
        replay.read_all()
    summary = replay.seen[-1]
    assert replay.process.returncode == 128 + signal.SIGINT
    assert summary["event"] == "summary"
    assert summary["recording"]["path"].endswith("session.mcap")
    assert not alive(started)

    by_node: dict[str, list[int]] = {}
    for event in recorded(replay.bag, "/play_launch/events"):
        by_node.setdefault(event.full_node_name, []).append(event.event_type)
    assert len(by_node) == 8
    for name, kinds in by_node.items():
        assert kinds == [LOADING, LOADED, UNLOADED], name
    states = recorded(replay.bag, "/play_launch/states")
    processes = [each for each in states if each.kind == PROCESS]
    by_process: dict[str, list[str]] = {}
    for each in processes:
        by_process.setdefault(each.name, []).append(each.state)
    assert by_process == {
        name: ["started", "ready", "stopping", "exited"]
        for name in ("/chat", "/sensing/camera", "/monitor")
    }
    assert all(each.exit_code == 0 and each.signal == 0 for each in processes)
    lines = [each.msg for each in recorded(replay.bag, "/play_launch/output")]
    assert any("I heard 'Hello from one process: 1'" in line for line in lines)
    reports = [line for line in lines if "by_pointer=" in line]
    assert reports
    for report in reports:
        counts = dict(part.split("=") for part in report.split() if "=" in part)
        assert counts["images"] == counts["by_pointer"], report
    with replay.bag.open("rb") as file:
        reader = make_reader(file)
        attachments = {each.name: each.data for each in reader.iter_attachments()}
        assert reader.get_header().profile == "ros2"
    assert attachments["config.yaml"] == DEMO.read_bytes()


def test_a_killed_container_is_restarted_with_its_nodes_within_bounds(tmp_path: Path) -> None:
    backoff = {"initial": "50 ms", "maximum": "100 ms"}
    loading = {"restart": {"max_restarts": 2, "within": "60 s", "backoff": backoff}}
    containers = [
        container("victim", node("talker"), node("listener", "Listener")),
        container("bystander", node("witness", "Listener")),
    ]
    config = written(tmp_path, composable_node_loading=loading, containers=containers)
    victims = dict.fromkeys(("/talker", "/listener"), "loaded")
    with replaying(config, tmp_path / "logs") as replay:
        replay.read_until_states({**victims, "/witness": "loaded"})
        (bystander,) = replay.told(name="/bystander", kind="started")
        dead = []
        for _ in range(2):
            pid = replay.told(name="/victim", kind="started")[-1]["pid"]
            victim = psutil.Process(pid)
            victim.send_signal(signal.SIGSEGV)
            gone = replay.until(name="/victim", kind="exited")
            assert (gone["pid"], gone["signal"]) == (pid, signal.SIGSEGV)
            dead.append(victim)
            replay.until(name="/victim", kind="started")
            replay.read_until_states(victims)
        os.kill(replay.told(name="/victim", kind="started")[-1]["pid"], signal.SIGKILL)
        given_up = replay.until(name="/victim", kind="gave_up")
        assert "2" in given_up["message"]
        assert not alive(dead)
        assert psutil.pid_exists(bystander["pid"])
        replay.process.send_signal(signal.SIGTERM)
        replay.read_all()
    assert replay.process.returncode == 128 + signal.SIGTERM
    kinds = Counter(
        each.state
        for each in recorded(replay.bag, "/play_launch/states")
        if (each.kind, each.name) == (PROCESS, "/victim")
    )
    assert (kinds["started"], kinds["gave_up"]) == (3, 1)


BROKEN = """
import sys
from play_launch.cli import entry
import play_launch.{module} as broken
def fail(*arguments, **options):
    raise OSError(24, "Too many open files")
broken.{function} = fail
entry.main()
"""


@pytest.mark.parametrize(
    ("module", "function", "what"),
    [
        ("postmortem.upkeep", "look_after_sessions", "care for earlier recordings"),
        ("control.serve", "package_version", "control by commands"),
    ],
)
def test_the_system_continues_without_a_service_that_fails_and_reports_that(
    module: str, function: str, what: str, tmp_path: Path
) -> None:
    idle = {"name": "idle", "command": ["sleep", "infinity"]}
    config = written(tmp_path, record={"ros": False}, nodes=[idle])
    program = (sys.executable, "-c", BROKEN.format(module=module, function=function))
    with replaying(config, tmp_path / "logs", program=program) as replay:
        reported = replay.until(event="log", name="play_launch.cli.background")
        assert reported["level"] == 40
        assert f"the system continues without {what}" in reported["message"]
        assert "Too many open files" in reported["message"]
        if module == "control.serve":
            assert "no session" in replay.ask("ps", code=1).stderr
        assert replay.process.poll() is None
        replay.process.send_signal(signal.SIGINT)
        assert replay.read_all()[-1]["exit_code"] == 128 + signal.SIGINT


def test_a_system_goes_on_and_ends_in_order_where_the_package_is_removed(tmp_path: Path) -> None:
    """As while it is upgraded: what is missed at the end should have been imported before."""
    copy = tmp_path / "copy" / "play_launch"
    shutil.copytree(ROOT / "play_launch", copy)
    config = written(
        tmp_path, containers=[container("chat", node("talker"), container_type="isolated")]
    )
    run = "from play_launch.cli.entry import main; main()"
    program = ("env", f"PYTHONPATH={copy.parent}", sys.executable, "-P", "-c", run)
    with replaying(config, tmp_path / "logs", program=program) as replay:
        replay.read_until_up("/talker")
        replay.until_operable()
        shutil.rmtree(copy)
        os.kill(replay.pids()["/talker"], signal.SIGSEGV)
        replay.until(event="component", kind="crashed")
        replay.until(event="node", node="/talker", state="loaded")
        replay.process.send_signal(signal.SIGINT)
        assert replay.read_all()[-1]["exit_code"] == 128 + signal.SIGINT
    assert recorded(replay.bag, "/play_launch/states")
