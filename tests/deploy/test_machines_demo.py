"""The demo on several machines: hosts of this computer, made for it and removed afterwards."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import psutil
import pytest

from play_launch import ExitCode
from play_launch.deploy.machines.namespaces import Namespaces, missing
from tests.support.replay import alive, replaying, run
from tests.support.waiting import until

PROGRAM = Path(sys.executable).with_name("play-launch")
needs_hosts = pytest.mark.skipif(bool(missing()), reason=f"hosts: {missing()}")


def test_without_asyncssh_the_demo_names_it(tmp_path: Path) -> None:
    (tmp_path / "sitecustomize.py").write_text("import sys; sys.modules['asyncssh'] = None\n")
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    refused = run("demo", "--machines", "2", code=2, env=environment)
    assert "pip install 'play-launch-py[machines]'" in refused.stderr


@needs_hosts
def test_the_demo_runs_on_several_machines(tmp_path: Path) -> None:
    demo = (str(PROGRAM), "demo", "--machines", "3", "--log-dir", str(tmp_path), "--json")
    with subprocess.Popen([*demo, "--seconds", "60"], stdout=subprocess.PIPE, text=True) as run:
        assert run.stdout is not None
        heard = (json.loads(line) for line in run.stdout)
        # The talker is on h1.
        next(each for each in heard if each["machine"] == "h3" and "I heard" in str(each))
        run.send_signal(signal.SIGTERM)
        states = {each["machine"]: each["state"] for each in heard if each["event"] == "machine"}
    assert run.returncode == 128 + signal.SIGTERM
    assert states == dict.fromkeys(("h1", "h2", "h3"), "ended")
    assert f"pl{run.pid}" not in subprocess.check_output(["ip", "netns", "list"], text=True)


@needs_hosts
def test_a_killed_demo_leaves_no_process_and_the_next_one_removes_its_hosts(
    tmp_path: Path,
) -> None:
    demo = (str(PROGRAM), "demo", "--machines", "2", "--log-dir", str(tmp_path), "--seconds", "60")
    with subprocess.Popen(demo, stdout=subprocess.PIPE, text=True) as run:
        assert run.stdout is not None
        assert "h2 are up" in run.stdout.readline()
        processes = psutil.Process(run.pid).children(recursive=True)
        run.kill()
    assert len(processes) >= 2, "the ssh servers at least"
    until(lambda: not alive(processes), "their end")
    left = f"pl{run.pid}h2"
    assert left in subprocess.check_output(["ip", "netns", "list"], text=True)
    with Namespaces(tmp_path / "hosts", 1):
        assert left not in subprocess.check_output(["ip", "netns", "list"], text=True)


UNITS = {
    "command: [bash, -c, exit 7]": ("exited", ExitCode.NODE_FAILED),
    "command: [bash, -c, kill -SEGV $$]": ("exited", ExitCode.NODE_FAILED),
    'command: ["true"]': ("exited", ExitCode.OK),
    'command: [sleep, "9"], depends_on: [{file: /not/there}]': ("waiting", ExitCode.NODES_MISSING),
}


@pytest.mark.parametrize("unit", UNITS)
def test_the_exit_code_follows_from_the_units(tmp_path: Path, unit: str) -> None:
    config, ends = tmp_path / "codes.yaml", tmp_path / "ends"
    config.write_text(
        f"""\
version: 1
machines: {{main: {{local: true}}}}
nodes:
  - {{name: unit, machine: main, {unit}}}
  - name: last
    machine: main
    on_exit: shutdown
    command: [bash, -c, "until [ -e {ends} ]; do read -t 0.05 <> <(:); done; true"]
"""
    )
    kind, code = UNITS[unit]
    with replaying(config, tmp_path / "logs") as replay:
        replay.until(event="process", name="/unit", kind=kind)
        ends.touch()
        replay.read_all()
    assert replay.process.returncode == code


def test_a_machine_whose_work_is_done_at_once_has_ended_well(tmp_path: Path) -> None:
    config = tmp_path / "quick.yaml"
    config.write_text(
        """\
version: 1
machines: {main: {local: true}}
nodes: [{name: quick, machine: main, command: ["true"]}]
"""
    )
    done = run("replay", config, "--log-dir", tmp_path / "logs", code=ExitCode.OK)
    assert "main has ended: its session has ended" in done.stdout + done.stderr


def test_people_read_of_each_node_once_that_it_is_loaded(tmp_path: Path) -> None:
    config, ends = tmp_path / "talk.yaml", tmp_path / "ends"
    config.write_text(
        f"""\
version: 1
machines: {{main: {{local: true}}}}
containers:
  - name: chat
    machine: main
    composable_nodes:
      - {{package: play_launch_demo, plugin: "play_launch_demo::Listener", name: listener}}
nodes:
  - name: last
    machine: main
    on_exit: shutdown
    command: [bash, -c, "until [ -e {ends} ]; do read -t 0.05 <> <(:); done; exit 7"]
"""
    )
    command = (str(PROGRAM), "replay", str(config), "--log-dir", str(tmp_path / "logs"))
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as replay:
        assert replay.stdout is not None
        lines: list[str] = []
        for line in replay.stdout:
            lines.append(line)
            if "listener loaded" in line:
                ends.touch()
    assert replay.returncode == ExitCode.NODE_FAILED
    told = [line.partition("] ")[2].strip() for line in lines if "[main " in line]
    nodes = [line.partition(" in ")[0] for line in told if "listener" in line]
    assert nodes == ["/listener loaded"]
    assert [line for line in told if "status" in line] == [
        "exited with status 7",
        "exited with status 0",
    ]
