"""A stop that nobody hurries gives everything its time."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import psutil

from tests.support.replay import replaying

CONFIG = """
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
    config.write_text(CONFIG, encoding="utf-8")
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
