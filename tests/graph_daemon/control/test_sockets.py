"""Who holds a port, by the kernel's tables."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from pathlib import Path

import psutil
import pytest

from play_launch.graph_daemon.control.sockets import (
    Holder,
    age_of,
    holder_of,
    is_stopped,
    time_wait_ports,
)


def test_a_listener_of_ours_is_ours() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
        holder = holder_of(port)
        assert holder is not None
        assert holder.pid == os.getpid()
        assert sys.executable.rsplit("/", 1)[-1] in str(holder)
    assert holder_of(port) is None


@pytest.mark.parametrize("daemon_first", [True, False])
def test_a_daemon_that_is_being_started_counts_before_its_starter(
    daemon_first: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Both have the socket, and psutil names one of them.
    program = "import sys; print(flush=True); sys.stdin.read()"
    with (
        socket.create_server(("127.0.0.1", 0)) as listener,
        subprocess.Popen(
            [sys.executable, "-c", program, "--name", "ros2-daemon"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            pass_fds=[listener.fileno()],
        ) as daemon,
    ):
        assert daemon.stdout is not None
        assert daemon.stdout.readline() == b"\n"
        named = daemon.pid if daemon_first else os.getpid()
        entries = [
            entry._replace(pid=named if entry.pid else None)
            for entry in psutil.net_connections("tcp")
        ]
        monkeypatch.setattr(psutil, "net_connections", lambda _kind: entries)
        holder = holder_of(listener.getsockname()[1])
        assert daemon.stdin is not None
        daemon.stdin.close()
    assert holder is not None
    assert holder.pid == daemon.pid
    assert holder.is_ros2_daemon


def test_a_listener_of_another_user_has_no_process(monkeypatch: pytest.MonkeyPatch) -> None:
    # Also where /proc is mounted with hidepid.
    with socket.create_server(("127.0.0.1", 0)) as listener:
        hidden = [entry._replace(pid=None) for entry in psutil.net_connections("tcp")]
        monkeypatch.setattr(psutil, "net_connections", lambda _kind: hidden)
        holder = holder_of(listener.getsockname()[1])
    assert holder == Holder(0, ())
    assert str(holder) == "a process of another user"
    assert not holder.is_daemon


def test_a_process_that_is_gone_meanwhile_has_no_command(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        gone = [entry._replace(pid=2**22 + 1) for entry in psutil.net_connections("tcp")]
        monkeypatch.setattr(psutil, "net_connections", lambda _kind: gone)
        assert holder_of(listener.getsockname()[1]) == Holder(2**22 + 1, ())


def test_without_proc_nobody_is_known(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(psutil, "PROCFS_PATH", str(tmp_path))
    with socket.create_server(("127.0.0.1", 0)) as listener:
        assert holder_of(listener.getsockname()[1]) is None
        assert time_wait_ports(listener.getsockname()[1]) == []
    assert age_of(os.getpid()) == 0
    assert not is_stopped(os.getpid())


def test_a_table_that_is_none_holds_nobody(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "net").mkdir()
    (tmp_path / "net" / "tcp").write_text("head\nnonsense\n")
    monkeypatch.setattr(psutil, "PROCFS_PATH", str(tmp_path))
    assert holder_of(11511) is None


def test_a_stopped_process_is_known() -> None:
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as process:
        assert not is_stopped(process.pid)
        process.send_signal(signal.SIGSTOP)
        os.waitid(os.P_PID, process.pid, os.WSTOPPED)
        assert is_stopped(process.pid)
        process.kill()
    assert not is_stopped(process.pid)


@pytest.mark.parametrize("where", ["0.0.0.0", "::"])
def test_a_listener_on_every_address_counts(where: str) -> None:
    family = socket.AF_INET6 if ":" in where else socket.AF_INET
    with socket.create_server((where, 0), family=family) as listener:
        holder = holder_of(listener.getsockname()[1])
        assert holder is not None
        assert holder.pid == os.getpid()


def test_a_closed_connection_shows_with_its_peers_port() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
        with socket.create_connection(listener.getsockname()) as client:
            peer = client.getsockname()[1]
            accepted, _ = listener.accept()
            # The first to close is the one who waits.
            accepted.shutdown(socket.SHUT_WR)
            assert client.recv(1) == b""
        assert accepted.recv(1) == b""
        accepted.close()
    assert peer in time_wait_ports(port)


@pytest.mark.parametrize(
    ("command", "ours", "stock"),
    [
        (("python3", "-P", "-m", "play_launch.graph_daemon", "--domain=3"), True, False),
        (("python3", "/usr/bin/play-launch", "daemon", "run"), True, False),
        (("python3", "-c", "from ros2cli.daemon.daemonize import main; main()"), False, True),
        (("python3", "-c", "x", "--name", "ros2-daemon", "--ros-domain-id", "0"), False, True),
        (("python3", "/usr/bin/play-launch", "daemon", "start"), False, False),
        (("nc", "-l", "11511"), False, False),
        ((), False, False),
    ],
)
def test_a_daemon_is_known_by_its_command(
    command: tuple[str, ...], ours: bool, stock: bool
) -> None:
    holder = Holder(1, command)
    assert (holder.is_ours, holder.is_ros2_daemon) == (ours, stock)
    assert holder.is_daemon == (ours or stock)


def test_a_process_has_an_age() -> None:
    assert 0 < age_of(os.getpid()) < age_of(1) + 1
    assert age_of(2**22 + 1) == 0
