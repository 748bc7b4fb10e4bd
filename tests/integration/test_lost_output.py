"""Output is not what a run is for: without it, it runs on and its recording is complete."""

from __future__ import annotations

import os
import pty
import signal
import subprocess
from pathlib import Path
from typing import Any

import pytest
from rosbags.highlevel import AnyReader

from tests.support.replay import COMMAND, recorded, run

CONFIG = """
version: 1
duration: {duration}
containers:
  - name: c
    composable_nodes:
      - {{package: play_launch_demo, plugin: "play_launch_demo::Talker", name: talker}}
nodes:
  - name: writes
    command: [sh, -c, "while :; do echo line; sleep 0.1; done"]
    on_exit: restart
"""
# Ends by itself when all is written.
LINES = 50
SHORT = f"""
version: 1
nodes:
  - name: writes
    command: [sh, -c, "for n in $(seq {LINES}); do echo line $n; done"]
"""


def write(folder: Path, duration: str) -> Path:
    config = folder / "config.yaml"
    config.write_text(CONFIG.format(duration=duration), encoding="utf-8")
    return config


def assert_recorded(logs: Path) -> None:
    """The recording was closed, and has the end of the process in it."""
    bag = logs / "latest" / "session.mcap"
    with AnyReader([bag]) as reader:
        count = sum(1 for _ in reader.messages())
    assert count > 10
    assert not list(bag.parent.glob("*.active"))


def lines(logs: Path) -> list[str]:
    """The output in the recording."""
    bag = logs / "latest" / "session.mcap"
    return [each.msg for each in recorded(bag, "/play_launch/output")]


@pytest.mark.parametrize(
    ("redirection", "arguments"),
    [(">&-", []), (">&-", ["--json"]), (">/dev/full 2>&1", []), (">/dev/full", ["--json"])],
)
def test_a_run_whose_output_nobody_takes(
    tmp_path: Path, redirection: str, arguments: list[str]
) -> None:
    config = tmp_path / "config.yaml"
    config.write_text(SHORT, encoding="utf-8")
    redirected = ["sh", "-c", f'exec "$@" {redirection}', "sh"]
    result = subprocess.run(
        [*redirected, COMMAND, "replay", config, "--log-dir", tmp_path / "logs", *arguments],
        check=False,
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert (result.returncode, result.stderr) == (0, "")
    assert_recorded(tmp_path / "logs")
    assert lines(tmp_path / "logs") == [f"line {number + 1}" for number in range(LINES)]


@pytest.mark.parametrize(("controls", "duration"), [(True, "50 s"), (False, "3 s")])
def test_a_run_whose_terminal_goes(tmp_path: Path, controls: bool, duration: str) -> None:
    config = write(tmp_path, duration)
    master, terminal = pty.openpty()
    # setsid -c makes it the controlling terminal, whose end is a SIGHUP; else there is only EIO.
    session = ["setsid", "-c"] if controls else ["setsid"]
    process = subprocess.Popen(
        [*session, COMMAND, "replay", config, "--log-dir", tmp_path / "logs"],
        stdin=terminal,
        stdout=terminal,
        stderr=terminal,
        env={**os.environ, "TERM": "xterm"},
        # Ignored where the tests run under nohup.
        preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_DFL),  # noqa: PLW1509
    )
    os.close(terminal)
    seen = b""
    while b"line" not in seen:
        seen += os.read(master, 65536)
    os.close(master)
    assert process.wait(timeout=60) == (128 + signal.SIGHUP if controls else 0)
    assert_recorded(tmp_path / "logs")


@pytest.mark.parametrize(
    ("verb", "redirection"),
    [
        ("check", ">/dev/full"),
        ("version", ">/dev/full 2>&1"),
        ("doctor", ">/dev/full"),
        ("--help", ">/dev/full"),
    ],
)
def test_a_command_whose_answer_cannot_be_written_fails(
    tmp_path: Path, verb: str, redirection: str
) -> None:
    arguments = [verb, str(write(tmp_path, "1 s"))] if verb == "check" else [verb]
    result = subprocess.run(
        ["sh", "-c", f'exec "$@" {redirection}', "sh", COMMAND, *arguments],
        check=False,
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert result.returncode == 2
    expected = "" if "2>" in redirection else "error: cannot write the output: No space left on"
    assert result.stderr.startswith(expected)
    assert "Traceback" not in result.stderr


def test_output_that_the_terminal_s_encoding_lacks_is_escaped(tmp_path: Path) -> None:
    config = tmp_path / "config.yaml"
    text = "version: 1\nnodes: [{name: n, command: [printf, '温度\\nlast\\n']}]\n"
    config.write_text(text, encoding="utf-8")
    environment = {**os.environ, "PYTHONIOENCODING": "latin-1"}
    logs = tmp_path / "logs"
    result = run("replay", config, "--log-dir", logs, text=False, env=environment)
    stdout: Any = result.stdout
    assert result.returncode == 0
    assert rb"\u6e29\u5ea6" in stdout
    assert b"last" in stdout
    assert b"Recording:" in stdout
