"""The command as a process: signals, pipes, terminals and exit codes."""

from __future__ import annotations

import fcntl
import json
import os
import pty
import select
import signal
import struct
import subprocess
import sys
import termios
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

import pytest

from tests.recording.reading import messages

ROOT = Path(__file__).resolve().parents[2]
Start = Callable[..., "subprocess.Popen[str]"]

CONFIG = """
version: 1
name: stub
containers:
  - name: c
    composable_nodes:
      - {package: p, plugin: "p::N", name: n0}
"""


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "stub.yaml"
    path.write_text(CONFIG, encoding="utf-8")
    return path


@pytest.fixture
def start(tmp_path: Path, config: Path) -> Any:
    processes: list[subprocess.Popen[str]] = []

    def run(*arguments: str, stub: str = "", **options: Any) -> subprocess.Popen[str]:
        process = subprocess.Popen(
            [
                sys.executable,
                "-m",
                "tests.cli.stub_command",
                "replay",
                str(config),
                "--log-dir",
                str(tmp_path / "logs"),
                *arguments,
            ],
            cwd=ROOT,
            env={**os.environ, "STUB": stub, "NO_COLOR": "1"},
            text=True,
            **{
                "stdout": subprocess.PIPE,
                "stderr": subprocess.PIPE,
                # Ignored where the tests run under nohup.
                "preexec_fn": lambda: signal.signal(signal.SIGHUP, signal.SIG_DFL),
                **options,
            },
        )
        processes.append(process)
        return process

    yield run
    for process in processes:
        if process.poll() is None:
            process.kill()
        process.wait()
        for stream in (process.stdout, process.stderr):
            if stream is not None:
                stream.close()


def read_until(stream: IO[str] | None, text: str) -> str:
    assert stream is not None
    read = ""
    for line in stream:
        read += line
        if text in line:
            return read
    raise AssertionError(f"{text!r} never came: {read}")


def bag(tmp_path: Path) -> Path:
    return tmp_path / "logs" / "latest" / "session.mcap"


@pytest.mark.parametrize("signum", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_each_signal_stops_in_order_and_names_the_recording(
    start: Start, tmp_path: Path, signum: signal.Signals
) -> None:
    process = start()
    read_until(process.stdout, "node is up")
    process.send_signal(signum)
    out, err = process.communicate()
    assert process.returncode == 128 + signum
    assert f"{signum.name}: shutting down" in out
    assert f"Recording: {bag(tmp_path).resolve()} (" in out
    assert err == ""
    recorded = [read.message.msg for read in messages(bag(tmp_path)) if "output" in read.topic]
    assert recorded == ["node is up"]


def test_a_second_signal_hurries(start: Start) -> None:
    process = start(stub="deaf")
    read_until(process.stdout, "node is up")
    process.send_signal(signal.SIGINT)
    read_until(process.stdout, "deaf to the first request")
    process.send_signal(signal.SIGTERM)
    process.communicate()
    assert process.returncode == 128 + signal.SIGINT


def test_nohup_is_respected(start: Start) -> None:
    process = start(preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_IGN))
    read_until(process.stdout, "node is up")
    process.send_signal(signal.SIGHUP)
    process.send_signal(signal.SIGTERM)
    out, _ = process.communicate()
    assert process.returncode == 128 + signal.SIGTERM
    assert "SIGHUP" not in out


def test_a_background_job_of_a_script_still_listens_to_sigint(start: Start) -> None:
    process = start(preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_IGN))
    read_until(process.stdout, "node is up")
    process.send_signal(signal.SIGINT)
    process.communicate()
    assert process.returncode == 128 + signal.SIGINT


def test_the_run_outlives_the_reader_of_its_output(start: Start, tmp_path: Path) -> None:
    process = start(stub="flood")
    read_until(process.stdout, "node is up")
    assert process.stdout is not None
    process.stdout.close()
    process.stdout = None
    process.send_signal(signal.SIGTERM)
    _, err = process.communicate()
    assert process.returncode == 128 + signal.SIGTERM
    assert err == ""
    assert len(messages(bag(tmp_path))) > 1


def test_a_full_pipe_holds_up_neither_the_run_nor_the_recording(
    start: Start, tmp_path: Path
) -> None:
    process = start(stub="flood")
    read_until(process.stdout, "node is up")
    # From here on there is no reader, and the pipe is full at once.
    process.send_signal(signal.SIGTERM)
    while not bag(tmp_path).exists():
        assert process.poll() is None
        select.select([], [], [], 0.01)
    out, err = process.communicate()
    assert process.returncode == 128 + signal.SIGTERM
    assert "Recording: " in out
    assert err == ""


def test_json_is_one_object_a_line_from_session_to_summary(start: Start, tmp_path: Path) -> None:
    process = start("--json", stub="failing ends")
    out, err = process.communicate()
    assert process.returncode == 1
    assert err == ""
    objects = [json.loads(line) for line in out.splitlines()]
    assert objects[0]["event"] == "session"
    assert Path(objects[0]["folder"]) == bag(tmp_path).resolve().parent
    assert [each["event"] for each in objects[1:-1]] == ["container", "node", "node", "output"]
    summary = objects[-1]
    assert (summary["event"], summary["exit_code"]) == ("summary", 1)
    assert summary["containers"][0]["failed"] == ["/n1"]
    assert Path(summary["recording"]["path"]) == bag(tmp_path).resolve()


def test_the_duration_of_the_command_line_counts(start: Start) -> None:
    process = start("--duration", "1 ms", "--quiet")
    out, _ = process.communicate()
    assert process.returncode == 0
    assert "time is over" not in out, "output is not shown with --quiet"


@pytest.mark.parametrize(("stub", "code"), [("ends", 0), ("ends failing", 1), ("ends slow", 3)])
def test_the_exit_code_tells_how_it_went(start: Start, stub: str, code: int) -> None:
    process = start(stub=stub)
    process.communicate()
    assert process.returncode == code


def test_a_terminal_shows_what_is_waited_for_and_gets_its_cursor_back(start: Start) -> None:
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 10, 40, 0, 0))
    process = start(stub="slow", stdout=theirs, preexec_fn=os.setsid)
    os.close(theirs)
    seen = b""
    asked = False
    while True:
        try:
            seen += os.read(ours, 65536)
        except OSError:  # EIO: the last writer has closed its side
            break
        if not asked and b"waiting on /n1" in seen:
            asked = True
            process.send_signal(signal.SIGINT)
    os.close(ours)
    process.communicate()
    assert process.returncode == 128 + signal.SIGINT
    assert asked
    assert b"[/c] node is up" in seen
    assert seen.rindex(b"\x1b[?25h") > seen.rindex(b"\x1b[?25l")
    assert b"Recording: " in seen[seen.rindex(b"\x1b[?25h") :].replace(b"\r\n", b"")
    assert b"\x1b[31m" not in seen, "NO_COLOR is set"


def test_the_recording_survives_a_sigkill(start: Start, tmp_path: Path) -> None:
    from tests.recording.reading import raw_messages

    process = start("--json", stub="flood")
    assert process.stdout is not None
    process.stdout.readline()
    active = bag(tmp_path).with_name("session.mcap.active")
    while not raw_messages(active, "/play_launch/output"):
        assert process.stdout.readline()
    process.kill()
    process.communicate()
    assert raw_messages(active, "/play_launch/output")


@pytest.mark.parametrize("stub", ["ends troubled", "slow troubled"])
def test_what_python_reports_is_shown_and_recorded_once(
    start: Start, tmp_path: Path, stub: str
) -> None:
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 30, 200, 0, 0))
    process = start("--duration", "2s", stub=stub, stdout=theirs, stderr=theirs)
    os.close(theirs)
    seen = b""
    while True:
        try:
            seen += os.read(ours, 65536)
        except OSError:  # EIO: the last writer has closed its side
            break
    os.close(ours)
    process.communicate()
    lines = seen.decode().splitlines()
    recorded = messages(tmp_path / "logs" / "latest" / "session.mcap")
    logged = [read.message for read in recorded if read.topic == "/play_launch/log"]
    for text, logger in (
        ("ValueError: callback failed", "asyncio"),
        ("ValueError: task failed", "asyncio"),
        ("ValueError: destructor failed", "python"),
        ("ValueError: thread failed", "python"),
        ("UserWarning: about to fail", "py.warnings"),
    ):
        (line,) = [line for line in lines if text in line]
        assert "[play-launch] " in line
        (message,) = [each for each in logged if text in each.msg]
        assert message.name == logger
    # Nothing of it stands across the view: its source is named.
    assert not any(line.startswith(("Traceback", "Exception", "Task")) for line in lines)
