"""Choice of the session, its user, and errors about sessions that do not answer."""

from __future__ import annotations

import contextlib
import json
import os
import pwd
import re
import select
import signal
import socket
import subprocess
import sys
import threading
from typing import TYPE_CHECKING, Any

import pytest

from play_launch.cli.connection import report_end
from play_launch.control import registration
from play_launch.control.client import SessionInfo
from play_launch.control.protocol import PROTOCOL, Code, OperationError, encode
from play_launch.control.registration import LINKS, address_of, registered
from play_launch.control.sessions import AmbiguousSessionError, NoSessionError, connect, twins
from play_launch.recording.folder import CONTROL_SOCKET
from tests.control.links import put_link
from tests.support.replay import COMMAND, replaying
from tests.support.waiting import until

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

OF_ANOTHER_USER = """
import json, os, socket, sys
os.chdir(sys.argv[1])
listening = socket.socket(socket.AF_UNIX)
listening.bind("control.sock")
os.setgroups([])
os.setresgid(54320, 54320, 54320)
os.setresuid(54321, 54321, 54321)
listening.listen()
print("listens", flush=True)
client, _ = listening.accept()
hello = dict(protocol=2, version="1", pid=1, name="robot", session="x", folder="/", started_ns=0)
client.sendall(json.dumps({"hello": hello}).encode() + b"\\n")
request = json.loads(client.recv(9999))
assert request["op"] == "environment"
found = {"LD_LIBRARY_PATH": "/mallory", "PATH": "/mallory", "ROS_DOMAIN_ID": "7"}
client.sendall(json.dumps({"id": request["id"], "result": found}).encode() + b"\\n")
client.recv(1)
"""
ROOT = """
import json, os, sys, types
sys.modules["rclpy"] = types.ModuleType("rclpy")  # root's Python may be out of that user's sight
from play_launch.cli.connection import enter_environment_of
from play_launch.control.sessions import connect_to
with connect_to(sys.argv[1]) as client:
    enter_environment_of(client)
users = [*os.getresuid(), *os.getresgid(), *os.getgroups()]
print(json.dumps([users, dict(os.environ)]))
"""
STAMP = "2026-11-24-10-00-00"


@pytest.fixture(autouse=True)
def links(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "links"
    monkeypatch.setenv(LINKS, str(folder))
    return folder


def leave_socket(folder: Path) -> None:
    """Leave what a supervisor leaves that was killed."""
    left = socket.socket(socket.AF_UNIX)
    left.bind(os.path.relpath(folder / CONTROL_SOCKET))
    left.close()


def test_the_socket_of_a_dead_supervisor_is_recognised(tmp_path: Path, links: Path) -> None:
    leave_socket(tmp_path)
    with subprocess.Popen(["cat"], stdin=subprocess.PIPE) as ended:
        put_link(links, ended.pid, tmp_path)
    with pytest.raises(NoSessionError, match="its supervisor was killed"):
        connect(str(tmp_path))
    with pytest.raises(NoSessionError, match=r"no session of yours is running; (.|\n)*was killed"):
        connect()
    assert not registered(), "the link of a dead process is removed"


def test_a_process_that_has_the_pid_of_a_dead_supervisor_is_not_to_be_killed(
    tmp_path: Path, links: Path
) -> None:
    leave_socket(tmp_path)
    put_link(links, os.getpid(), tmp_path, start_time=1)
    with pytest.raises(NoSessionError, match="its supervisor was killed") as refused:
        connect()
    assert "kill -INT" not in str(refused.value)
    assert not registered()


def test_a_pid_of_another_namespace_is_not_to_be_killed(tmp_path: Path, links: Path) -> None:
    link = put_link(links, os.getpid(), tmp_path / "not_here", namespace=1)
    with pytest.raises(NoSessionError) as refused:
        connect()
    assert str(refused.value) == "no session of yours is running; start one with play-launch replay"
    with pytest.raises(NoSessionError, match=r"no session is running in .*not_here$"):
        connect(str(os.getpid()))
    assert registered() == [link], "it may run, out of our sight"


def test_a_supervisor_whose_folder_is_gone_can_be_ended(tmp_path: Path, links: Path) -> None:
    put_link(links, os.getpid(), tmp_path / "not_here")
    for session in (None, str(os.getpid())):
        with pytest.raises(NoSessionError, match=rf"kill -INT {os.getpid()} ends it in order"):
            connect(session)
    assert registered()


def test_links_of_another_user_are_not_followed(
    tmp_path: Path, links: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    put_link(links, 1, tmp_path)
    assert registered()
    monkeypatch.setattr(os, "geteuid", lambda: 4711)
    assert not registered()
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.undo()
    monkeypatch.setenv(LINKS, str(tmp_path / "link"))
    (tmp_path / "link").symlink_to(elsewhere)
    assert not registered()


@pytest.fixture
def session(tmp_path: Path, links: Path) -> Iterator[Callable[..., Path]]:
    """Make sessions that send a hello, or not (``protocol=0``), and nothing else."""
    with contextlib.ExitStack() as opened:

        def make(name: str, protocol: int = PROTOCOL, folder: str = "") -> Path:
            path = tmp_path / "logs" / (folder or f"{STAMP}-{name}")
            path.mkdir(parents=True)
            process = opened.enter_context(subprocess.Popen(["cat"], stdin=subprocess.PIPE))
            listening = opened.enter_context(socket.socket(socket.AF_UNIX))
            with address_of(str(path)) as address:
                listening.bind(address)
            listening.listen()
            hello = {"protocol": protocol, "version": "1", "pid": process.pid, "name": name}
            hello |= {"session": "x", "folder": str(path), "started_ns": 0}
            if protocol:
                thread = threading.Thread(target=greet, args=(listening, hello))
                thread.start()
                opened.callback(thread.join)
                opened.callback(listening.shutdown, socket.SHUT_RDWR)
            put_link(links, process.pid, path)
            return path

        yield make


def greet(listening: socket.socket, hello: dict[str, Any]) -> None:
    with contextlib.ExitStack() as opened, contextlib.suppress(OSError):
        while True:
            connection = opened.enter_context(listening.accept()[0])
            connection.sendall(encode({"hello": hello}))


def connected(session: str | None = None, **how: Any) -> str:
    with connect(session, **how) as client:
        return client.hello.folder


@pytest.mark.parametrize("protocol", [0, PROTOCOL + 1], ids=["silent", "of another release"])
def test_a_session_is_not_chosen_because_another_one_does_not_answer(
    session: Callable[..., Path], protocol: int
) -> None:
    base, arm = session("base"), session("arm", protocol)
    with pytest.raises(AmbiguousSessionError, match="2 sessions are running") as refused:
        connect()
    assert f"  base  {base}" in str(refused.value)
    reason = "does not answer" if protocol == 0 else f"uses protocol {protocol}"
    assert re.search(f"{re.escape(str(arm))}.* {reason}", str(refused.value))


def test_of_one_name_the_session_that_answers_is_not_chosen(session: Callable[..., Path]) -> None:
    answers, silent = session("robot"), session("robot", 0, f"{STAMP}-robot-2")
    with pytest.raises(AmbiguousSessionError, match="are, or may be, called robot") as refused:
        connect("robot", limit=0.2)
    assert str(answers) in str(refused.value)
    assert f"the session in {silent} does not answer" in str(refused.value)


def test_a_session_that_ctrl_z_stopped_is_told_as_such(session: Callable[..., Path]) -> None:
    folder = session("robot", 0)
    (link,) = registered()
    os.kill(link.pid, signal.SIGSTOP)
    os.waitid(os.P_PID, link.pid, os.WSTOPPED)
    for named in (None, str(folder)):
        with pytest.raises(OperationError, match=f"kill -CONT {link.pid}, continues it"):
            connect(named, limit=0.2)
    os.kill(link.pid, signal.SIGCONT)
    with pytest.raises(OperationError, match=r"does not answer$"):
        connect(limit=0.2)


def test_a_silent_session_of_another_name_delays_no_command(session: Callable[..., Path]) -> None:
    session("arm", 0)
    base = session("base")
    assert connected("base", limit=10_000) == str(base)
    with pytest.raises(OperationError, match="does not answer") as refused:
        connect("arm", limit=0.2)
    assert refused.value.code == Code.TIMEOUT
    with pytest.raises(NoSessionError, match=r"no session gripper(.|\n)*arm does not answer"):
        connect("gripper")


def test_a_killed_session_that_is_a_zombie_is_no_second_one(
    session: Callable[..., Path], tmp_path: Path, links: Path
) -> None:
    base = session("base")
    leave_socket(tmp_path)
    with subprocess.Popen(["cat"], stdin=subprocess.PIPE) as killed:
        put_link(links, killed.pid, tmp_path)
        killed.send_signal(signal.SIGKILL)
        os.waitid(os.P_PID, killed.pid, os.WEXITED | os.WNOWAIT)
        assert connected() == str(base)


def test_a_folder_of_that_name_here_is_not_the_session(
    session: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = session("robot")
    pid = str(registered()[0].pid)
    work = tmp_path / "work"
    for name in ("robot", pid):
        (work / name).mkdir(parents=True)
    monkeypatch.chdir(work)
    for name in ("robot", pid, str(folder)):
        assert connected(name) == str(folder)
    with pytest.raises(NoSessionError, match=r"no session is running in \./robot"):
        connect("./robot")
    monkeypatch.chdir(folder)
    assert connected(".") == str(folder)
    monkeypatch.chdir(folder.parent)
    (folder.parent / "latest").symlink_to(folder.name)
    assert connected("latest") == str(folder)


def test_root_is_told_whose_sessions_there_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """``sudo play-launch ps`` is meant for the session of the user, not of root."""
    user = os.geteuid() or 54321
    links = tmp_path / f"play_launch-{user}"
    folders = [tmp_path / "robot", tmp_path / "of\nmallory"]
    for folder, start_time in zip(folders, (None, 1), strict=True):
        put_link(links, os.getpid(), folder, start_time=start_time)
    (tmp_path / "play_launch-99999").symlink_to(links)
    os.chown(links, user, -1)
    monkeypatch.delenv(LINKS)
    monkeypatch.setattr(registration, "SHARED_MEMORY", str(tmp_path))
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    theirs = f"""
sessions of other users, to be named with --session FOLDER:
  {os.getpid():>8}  user {name_of(user)}  {folders[0]}"""
    for session in (None, "robot"):
        with pytest.raises(NoSessionError) as refused:
            connect(session)
        assert str(refused.value).endswith(theirs)
    put_link(links, os.getppid(), folders[1])
    with pytest.raises(NoSessionError, match=r"/of\\nmallory'"):
        connect()
    monkeypatch.setattr(os, "geteuid", lambda: 54322)
    with pytest.raises(NoSessionError, match=r"with play-launch replay$"):
        connect()


def name_of(user: int) -> str:
    try:
        return pwd.getpwuid(user).pw_name
    except KeyError:
        return str(user)


@pytest.mark.skipif(os.geteuid() != 0, reason="needs root to become another user")
def test_root_speaks_ros_as_the_user_of_the_session(tmp_path: Path) -> None:
    """What that user says about ROS loads libraries: profiles, a middleware."""
    before = os.environ | {"CYCLONEDDS_URI": "file:///of/another/robot.xml"}
    command = [sys.executable, "-c", OF_ANOTHER_USER, str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as session:
        assert session.stdout is not None
        assert session.stdout.readline() == b"listens\n"
        done = subprocess.run(
            [sys.executable, "-c", ROOT, str(tmp_path)],
            check=True,
            stdout=subprocess.PIPE,
            env=before,
            timeout=60,
        )
    users, after = json.loads(done.stdout)
    assert users == [54321] * 3 + [54320] * 4
    assert after["HOME"] == "/"
    assert after["ROS_DOMAIN_ID"] == "7"
    assert "CYCLONEDDS_URI" not in after
    for name in ("PATH", "LD_LIBRARY_PATH"):
        assert after.get(name) == before.get(name)


def test_the_name_of_a_session_that_has_ended_does_nothing_to_the_terminal(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """What listens may be another user's program, which root was told of."""
    hello = SessionInfo(1, "ro\x1b[31mbot", "x", str(tmp_path), "1", 0, "")
    assert report_end(hello) == 0
    assert capsys.readouterr().err == "the session robot (pid 1) has ended\n"


@pytest.mark.parametrize(
    ("number", "code", "words"),
    [
        (signal.SIGINT, 0, "the session robot (pid {}) has ended\n"),
        (signal.SIGKILL, 1, "error: the supervisor of the session robot (pid {}) was killed\n"),
    ],
)
def test_what_follows_a_session_reports_how_it_ended(
    number: signal.Signals, code: int, words: str, tmp_path: Path
) -> None:
    config = tmp_path / "robot.yaml"
    node = "{name: talker, command: [sh, -c, echo hello; exec sleep infinity]}"
    config.write_text(f"{{version: 1, name: robot, record: {{ros: false}}, nodes: [{node}]}}")
    with replaying(config, tmp_path / "logs") as replay, contextlib.ExitStack() as opened:
        replay.read_until(lambda event: event.get("text") == "hello", "its output")
        waiting = [str(COMMAND), "wait", "--timeout", "60"]
        subprocess.run(waiting, check=True, stdout=subprocess.DEVNULL)
        piped: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
        followers = [
            opened.enter_context(subprocess.Popen([str(COMMAND), verb, "-f"], **piped))
            for verb in ("events", "logs")
        ]
        for each in followers:
            opened.callback(each.kill)
        for each in followers:
            opened.callback(each.kill)
        pipes = [each.stdout for each in followers if each.stdout is not None]
        until(lambda: len(select.select(pipes, [], [], 0)[0]) == len(pipes), "lines of the past")
        replay.process.send_signal(number)
        for each in followers:
            assert each.communicate(timeout=60)[1] == words.format(replay.pid)
            assert each.returncode == code


def test_a_system_that_runs_twice_is_warned_of(tmp_path: Path) -> None:
    config = tmp_path / "robot.yaml"
    config.write_text(
        "version: 1\nnodes:\n- {name: twin, command: [sleep, '1000']}\n- {command: [sleep, '9']}\n"
    )
    domain = os.environ.get("ROS_DOMAIN_ID") or "0"
    with replaying(config, tmp_path / "first") as first:
        first.until_operable()
        assert [shared for _, shared in twins(["/twin", "/other"], domain)] == [["/twin"]]
        assert not twins(["/twin"], "101")
        assert not twins(["/twin"], domain, but="robot")
        with replaying(config, tmp_path / "second") as second:
            text = f"session robot (pid {first.pid}) runs /twin as well: end one of the two"
            second.until(event="log", message=text)
