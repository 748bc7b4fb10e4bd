"""Who waits for a session that is being stopped."""

from __future__ import annotations

import signal
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from play_launch.control.protocol import ControlError
from play_launch.control.sessions import connect_to
from tests.support.replay import replaying

DEAF = """
import signal, time
for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
    signal.signal(number, signal.SIG_IGN)
print("deaf now", flush=True)
while True:
    time.sleep(1000)
"""


def test_nobody_waits_for_what_does_not_come_up_any_more(tmp_path: Path) -> None:
    deaf, config = tmp_path / "deaf.py", tmp_path / "robot.yaml"
    deaf.write_text(DEAF, encoding="utf-8")
    config.write_text(
        f"version: 1\nstop: {{sigint: 5 s}}\nnodes:\n"
        f"- {{name: deaf, command: [{sys.executable}, {deaf}]}}\n"
        f"- {{name: late, command: [sleep, '1000'], start_delay: 1000 s}}\n",
        encoding="utf-8",
    )
    with replaying(config, tmp_path / "logs") as replay:
        replay.read_until(lambda event: event.get("text") == "deaf now", "a deaf process")
        folder = str(replay.log_dir / "latest")
        with connect_to(folder) as waiting, ThreadPoolExecutor(1) as thread:
            answer = thread.submit(waiting.ask, "wait", {"timeout": 600.0}, limit=600.0)
            replay.process.send_signal(signal.SIGINT)
            with pytest.raises(ControlError, match="the session is being stopped"):
                answer.result(timeout=60)
