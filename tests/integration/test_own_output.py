"""Standard output belongs to play-launch; without it, a run goes on and is recorded."""

from __future__ import annotations

import fcntl
import json
import os
import pty
import re
import select
import signal
import struct
import subprocess
import sys
import termios
from pathlib import Path
from typing import Any

import pytest
from rosbags.highlevel import AnyReader

from tests.support.mounts import mounted
from tests.support.replay import COMMAND, recorded, run
from tests.support.scenes import written
from tests.support.stock import EXECUTABLE, PACKAGE, install
from tests.support.waiting import until

NOISE = "noise of a library"
WORDS = f"stdout of a library: {NOISE}"
# Python runs it at its start. It stands for a library that writes when it is loaded.
SITE = """
import ctypes, sys
def hook(event, arguments):
    if event == "import" and arguments[0] == {module!r}:
        # As C code that was called from Python: the interpreter's lock is held meanwhile.
        text = {text!r} * {times}
        ctypes.PyDLL(None).write(1, text, len(text))
sys.addaudithook(hook)
"""
# A participant takes the number of a port whose lock is free. These are held by the process
# that becomes the supervisor.
LOCKS = """
import fcntl, os, sys
for number in map(int, sys.argv[1].split(",")):
    for version in ("fastrtps", "fastdds"):
        lock = os.open(f"/dev/shm/{version}_port{number}_el", os.O_CREAT | os.O_RDWR, 0o666)
        fcntl.flock(lock, fcntl.LOCK_EX)
        os.set_inheritable(lock, True)
os.execv(sys.argv[2], sys.argv[2:])
"""
PORTS = range(7000, 7003)
FAST_DDS_3 = Path(sys.prefix, "lib", "libfastdds.so").exists()
# Waits for a container that never comes, with a participant of the supervisor's own.
ATTACHING = {
    "duration": "1 s",
    "containers": [{"name": "absent", "container_type": "stock", "attach": True}],
}


def noisy(folder: Path, module: str, times: int = 1) -> dict[str, str]:
    """Return an environment in which that import writes to descriptor 1."""
    place = folder / "site"
    place.mkdir()
    text = f"\x1b[37;1m{NOISE}\x1b[m\n".encode()
    (place / "sitecustomize.py").write_text(SITE.format(module=module, text=text, times=times))
    paths = [str(place), *filter(None, [os.environ.get("PYTHONPATH")])]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}


def execute(command: list[Any], **options: Any) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        command, capture_output=True, text=True, check=False, timeout=120, **options
    )


def replay(config: Path, *arguments: str) -> list[Any]:
    return [COMMAND, "replay", config, "--log-dir", config.parent / "logs", *arguments]


def logged(folder: Path) -> list[str]:
    """The log in the recording of the only session below a folder."""
    bag = folder / "logs" / "latest" / "session.mcap"
    return [each.msg for each in recorded(bag, "/play_launch/log/all")]


def warnings(events: list[dict[str, Any]]) -> list[str]:
    return [event["message"] for event in events if event["event"] == "log" and event["level"] > 20]


@pytest.mark.parametrize("arguments", [[], ["--json"]], ids=["plain", "json"])
def test_what_a_library_writes_during_a_run_is_in_its_log(
    tmp_path: Path, arguments: list[str]
) -> None:
    config = written(tmp_path, **ATTACHING)
    result = execute(replay(config, *arguments), env=noisy(tmp_path, "rclpy"))
    assert (result.returncode, result.stderr) == (3, "")
    if arguments:
        assert WORDS in warnings([json.loads(line) for line in result.stdout.splitlines()])
    else:
        assert result.stdout.count(f"[play-launch] {WORDS}\n") == 1
    assert WORDS in logged(tmp_path)


def test_a_run_without_output_has_it_in_its_log_as_well(tmp_path: Path) -> None:
    config = written(tmp_path, **ATTACHING)
    redirected = ["sh", "-c", 'exec "$@" <&- >&- 2>&-', "sh"]
    result = execute([*redirected, *replay(config)], env=noisy(tmp_path, "rclpy"))
    assert (result.returncode, result.stdout, result.stderr) == (3, "", "")
    assert WORDS in logged(tmp_path)


def test_a_library_that_writes_without_end_does_not_stop_the_supervisor(tmp_path: Path) -> None:
    config = written(tmp_path, **ATTACHING)
    environment = noisy(tmp_path, "rclpy", times=20_000)
    result = execute(replay(config, "--json"), env=environment)
    assert result.returncode == 3
    found = warnings([json.loads(line) for line in result.stdout.splitlines()])
    assert 100 < found.count(WORDS) < 20_000
    assert any("lines may be missing here" in each for each in found)


@pytest.mark.parametrize(
    ("module", "arguments"),
    [
        ("play_launch.config", ["check", "CONFIG", "--json"]),
        ("play_launch.doctor.ros", ["doctor", "--json"]),
        ("play_launch.graph_daemon.port", ["daemon", "status", "--json"]),
        ("play_launch.recording.environment", ["version", "--json"]),
    ],
    ids=lambda value: value[0] if isinstance(value, list) else "",
)
def test_what_a_library_writes_during_a_command_is_on_stderr(
    tmp_path: Path, module: str, arguments: list[str]
) -> None:
    config = str(written(tmp_path, **ATTACHING))
    command = [config if argument == "CONFIG" else argument for argument in arguments]
    result = run(*command, env=noisy(tmp_path, module))
    json.loads(result.stdout)
    assert result.stderr.count(NOISE) == 1


def test_the_doctor_understands_a_python_whose_libraries_write(tmp_path: Path) -> None:
    # By importlib rclpy itself is imported, which is not seen; it imports others.
    result = run("doctor", "--json", env=noisy(tmp_path, "rclpy.context"))
    found = {each["subject"]: each for each in json.loads(result.stdout)["findings"]}
    assert result.returncode == 0
    assert found["middleware"]["says"].startswith("rmw_")


def test_errors_of_fast_dds_leave_json_as_it_is(tmp_path: Path) -> None:
    double = install(tmp_path)
    box = {
        "name": "box",
        "container_type": "stock",
        "package": PACKAGE,
        "executable": EXECUTABLE,
        "composable_nodes": [{"package": "any", "plugin": "any::Node", "name": "one"}],
    }
    config = written(tmp_path, containers=[box])
    locks = [sys.executable, "-c", LOCKS, ",".join(map(str, PORTS))]
    events = []
    with subprocess.Popen(
        mounted("mount -t tmpfs tmpfs /dev/shm", *locks, *replay(config, "--json")),
        # With peers our participant has shared memory, as rmw_fastrtps decides.
        env={**os.environ, **double.environment, "ROS_STATIC_PEERS": "127.0.0.1"},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        for line in process.stdout:
            events.append(json.loads(line))
            # The participant takes other ports, and everything works.
            if (events[-1]["event"], events[-1].get("state")) == ("node", "loaded"):
                process.terminate()
        stderr = process.stderr.read()
    assert process.returncode == 128 + signal.SIGTERM
    if FAST_DDS_3:  # it writes its errors to standard error
        assert stderr.count("open_and_lock_file failed") == len(PORTS)
        return
    assert not stderr
    assert events[-1]["containers"][0]["loaded"] == 1
    words = "stdout of a library: "
    errors = [each for each in warnings(events) if each.startswith(words)]
    assert len(errors) == len(PORTS)
    for error in errors:
        assert "open_and_lock_file failed" in error
        assert "\x1b" not in error


def test_a_terminal_is_still_known(tmp_path: Path) -> None:
    master, terminal = pty.openpty()
    fcntl.ioctl(terminal, termios.TIOCSWINSZ, struct.pack("HHHH", 40, 60, 0, 0))
    environment = {**os.environ, "TERM": "xterm"}
    for name in ("COLUMNS", "LINES", "NO_COLOR", "FORCE_COLOR"):
        environment.pop(name, None)
    with subprocess.Popen(
        [COMMAND, "doctor"],
        stdin=subprocess.DEVNULL,
        stdout=terminal,
        stderr=subprocess.DEVNULL,
        env=environment,
    ):
        os.close(terminal)
        seen = b""
        while more := _read(master):
            seen += more
    os.close(master)
    text = seen.decode()
    assert "\x1b[32m" in text
    widths = [len(line) for line in re.sub(r"\x1b\[[0-9;]*m", "", text).splitlines()]
    assert 50 < max(widths) <= 60


def _read(descriptor: int) -> bytes:
    try:
        return os.read(descriptor, 65536)
    except OSError:  # EIO: the other end is closed
        return b""


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
# Exits when all is written.
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
def test_a_run_whose_output_is_not_read(
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


@pytest.mark.parametrize("arguments", [[], ["--json"]])
def test_a_pipe_that_takes_nothing_does_not_hold_up_the_end(
    tmp_path: Path, arguments: list[str]
) -> None:
    config = tmp_path / "config.yaml"
    config.write_text(SHORT.replace(f"seq {LINES}", "seq 30000").replace("done", "done; sleep 60"))
    command = [str(COMMAND), "replay", str(config), f"--log-dir={tmp_path}/logs", *arguments]
    reading, writing = os.pipe()
    with subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=writing) as unread:
        try:
            until(lambda: not select.select([], [writing], [], 0)[1], "a pipe that is full")
            unread.send_signal(signal.SIGINT)
            assert unread.wait(30) == 130
        finally:
            os.close(reading)
            os.close(writing)
    assert_recorded(tmp_path / "logs")


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
