"""SIGINT and SIGTERM at any moment end everything, the recording is whole; a stop has its time."""

from __future__ import annotations

import os
import signal
import subprocess
import tempfile
import time
import uuid
from pathlib import Path

import psutil
import pytest
from rosbags.highlevel import AnyReader

from tests.support.replay import COMMAND, replaying, run
from tests.support.shared_memory import ports_left_in
from tests.support.waiting import until

# What the shell starts in the background ignores SIGINT: every run waits for the whole of sigint.
CONFIG = """
version: 1
stop: {ask: 3 s, sigint: 400 ms, sigterm: 2 s}
containers:
  - name: chat
    composable_nodes:
      - {package: play_launch_demo, plugin: play_launch_demo::Talker, name: talker}
      - {package: play_launch_demo, plugin: play_launch_demo::Listener, name: listener}
  - name: camera
    container_type: mt
    composable_nodes:
      - package: play_launch_demo
        plugin: play_launch_demo::ImageSource
        name: front
        extra_arguments: {use_intra_process_comms: true}
      - package: play_launch_demo
        plugin: play_launch_demo::ImageSink
        name: detector
        extra_arguments: {use_intra_process_comms: true}
  - name: slow
    composable_nodes:
      - package: play_launch_demo
        plugin: play_launch_demo::SlowConstructor
        name: slow_starter
        parameters: {seconds: 0.7}
      - {package: play_launch_demo, plugin: play_launch_demo::ThrowingConstructor, name: broken}
nodes:
  - name: shell
    command: [sh, -c, "sleep 600 & sleep 600"]
"""
# Python runs it at its start.
INTERRUPTED = """
import os, signal, sys
def hook(event, arguments):
    if event == "import" and arguments[0] == {module!r}:
        os.kill(os.getpid(), signal.SIGINT)
sys.addaudithook(hook)
"""
MARK = "PLAY_LAUNCH_TEST_MARK"


def marked(mark: str) -> list[int]:
    """Pids of all processes that inherited the mark, whatever their parent is by now."""
    needle = f"{MARK}={mark}".encode()
    found = []
    for pid in psutil.pids():
        try:
            environment = Path(f"/proc/{pid}/environ").read_bytes()
        except OSError:
            continue
        if needle in environment.split(b"\0"):
            found.append(pid)
    return found


def run_and_interrupt(
    domain: int, after: float, signum: signal.Signals, *, from_first_line: bool
) -> None:
    """Send ``signum`` ``after`` seconds; assert that nothing is left but a whole recording."""
    mark = uuid.uuid4().hex
    with tempfile.TemporaryDirectory() as folder:
        config = Path(folder) / "config.yaml"
        config.write_text(CONFIG, encoding="utf-8")
        logs = Path(folder) / "logs"
        process = subprocess.Popen(
            [COMMAND, "replay", config, "--log-dir", logs],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, MARK: mark},
        )
        assert process.stdout is not None
        first = process.stdout.readline() if from_first_line else ""
        # The moment is the input of this test, so it is slept for, not waited for.
        time.sleep(after)
        process.send_signal(signum)
        try:
            output, errors = process.communicate(timeout=60)
        except subprocess.TimeoutExpired as expired:
            process.kill()
            output, errors = process.communicate()
            raise AssertionError(
                f"{signum.name} after {after:.3f} s had no effect\n{first}{output}{errors}"
            ) from expired
        story = f"{signum.name} after {after:.3f} s: {process.returncode}\n{first}{output}{errors}"
        if process.returncode < 0:
            # Python died of the signal, with the default disposition: then the session guard, if it
            # runs already, ends what was started for the containers, and itself, a moment later,
            # and leaves one behind that sweeps. Nothing is in /proc of the environment of a process
            # that is just being executed, hence several looks.
            until(lambda: not any(marked(mark) for _ in range(5)), f"the end of all after {story}")
        else:
            assert marked(mark) == [], story
        assert not ports_left_in(domain), story
        sessions = list(logs.glob("*/session.mcap")) if logs.is_dir() else []
        assert not list(logs.glob("*/*.active")), story
        if not from_first_line and not sessions:
            # Python itself, or the kernel, answered while the interpreter was starting.
            assert process.returncode in {128 + signum, -signum, 1}, story
            return
        assert process.returncode == 128 + signum, story
        assert "Traceback" not in errors, story
        assert sessions, story
        for path in sessions:
            with AnyReader([path]) as reader:
                for connection, _, raw in reader.messages():
                    reader.deserialize(raw, connection.msgtype)


SIGNALS = (signal.SIGINT, signal.SIGTERM)
STEP = 0.13
"""Seconds between two moments of bring-up, which takes about a second."""


@pytest.mark.parametrize("step", range(10))
def test_a_signal_at_any_moment_of_bring_up_ends_everything(ros_domain: int, step: int) -> None:
    signum = SIGNALS[step % len(SIGNALS)]
    run_and_interrupt(ros_domain, step * STEP, signum, from_first_line=True)


@pytest.mark.parametrize("step", range(5))
def test_a_signal_before_anything_runs_leaves_nothing(ros_domain: int, step: int) -> None:
    signum = SIGNALS[step % len(SIGNALS)]
    run_and_interrupt(ros_domain, step * 0.11, signum, from_first_line=False)


@pytest.mark.parametrize("module", ["play_launch.cli.app", "play_launch.cli.output"])
def test_a_signal_amid_our_imports_ends_the_command_without_a_word(
    module: str, tmp_path: Path
) -> None:
    (tmp_path / "sitecustomize.py").write_text(INTERRUPTED.format(module=module))
    paths = [str(tmp_path), *filter(None, [os.environ.get("PYTHONPATH")])]
    result = run("ps", env={**os.environ, "PYTHONPATH": os.pathsep.join(paths)})
    assert (result.returncode, result.stdout, result.stderr) == (-signal.SIGINT, "", "")


PAIR = """
version: 1
stop: {ask: 3 s, sigint: 5 s, sigterm: 2 s}
containers:
  - name: pair
    container_type: isolated
    isolation: process
    on_crash: shutdown
    composable_nodes:
      - {package: play_launch_demo, plugin: play_launch_demo::Talker, name: one}
      - {package: play_launch_demo, plugin: play_launch_demo::Talker, name: two}
nodes:
  - name: slow_to_end
    command: [bash, -c, 'trap "sleep 1; exit 7" INT; echo ready; while :; do sleep 0.05; done']
"""


def test_two_crashes_of_one_moment_that_shut_down_do_not_hurry(tmp_path: Path) -> None:
    config = tmp_path / "config.yaml"
    config.write_text(PAIR, encoding="utf-8")
    with replaying(config, tmp_path / "logs") as run:
        pids = [
            each["pid"]
            for name, each in run.read_until_up("/one", "/two").items()
            if name in ("/one", "/two")
        ]
        if not run.told(event="output", text="ready"):
            run.until(event="output", text="ready")
        # The supervisor hears of both in one read.
        os.kill(run.pid, signal.SIGSTOP)
        nodes = [psutil.Process(pid) for pid in pids]
        for node in nodes:
            node.send_signal(signal.SIGSEGV)
        psutil.wait_procs(nodes, timeout=60)
        os.kill(run.pid, signal.SIGCONT)
        run.read_all()
    assert len(run.told(event="node", state="crashed")) == 2
    (ended,) = run.told(event="process", name="/slow_to_end", kind="exited")
    assert (ended["exit_code"], ended["signal"]) == (7, 0), "it was given its time after SIGINT"
    assert run.process.returncode == 1
