"""Daemons in the background, from their start to their end, whatever ends them."""

from __future__ import annotations

import contextlib
import json
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import psutil
import pytest

from play_launch.graph_daemon import port
from play_launch.graph_daemon.contract import LISTENING, STATUS_METHOD, DaemonAddress
from play_launch.graph_daemon.daemon import LONGEST_DOUBT, REPLACEMENT_TIME, Doubts
from play_launch.graph_daemon.port import OwnerKind, PortHeldError, find_owner, stop_daemon
from play_launch.graph_daemon.start_stop import (
    DaemonStartError,
    StartedDaemon,
    log_path,
    start_daemon,
)
from play_launch.ros.fastdds.shared_memory import sweep
from tests.graph_daemon.occupants import end_daemons, occupied
from tests.graph_daemon.wire import ask
from tests.support.waiting import until

WAIT = 60.0


@pytest.fixture(autouse=True)
def _ended(address: DaemonAddress, logs: Path) -> Iterator[None]:
    assert find_owner(address).kind is OwnerKind.FREE
    yield
    try:
        stop_daemon(address)
    finally:
        end_daemons(address.domain)
    assert find_owner(address).kind is OwnerKind.FREE


def sweep_after_a_kill() -> None:
    """Remove what a killed daemon leaves in shared memory, as the next replay would."""
    sweep()  # or another process has, meanwhile


def gone(started: StartedDaemon) -> int:
    assert started.process is not None
    return started.process.wait(WAIT)


def stock_can_start(address: DaemonAddress) -> bool:
    """Bind as ros2cli's daemon does it, without SO_REUSEADDR."""
    with socket.socket() as stock:
        try:
            stock.bind((address.host, address.port))
        except OSError:
            return False
    return True


def test_it_is_detached_from_its_starter(address: DaemonAddress, tmp_path: Path) -> None:
    started = start_daemon(address, wait_for=LISTENING)
    process = Path("/proc") / str(started.pid)
    assert os.getsid(started.pid) == started.pid
    assert (process / "cwd").readlink() == Path("/")
    assert [(process / "fd" / str(number)).readlink() for number in (0, 1)] == [
        Path("/dev/null"),
        log_path(address),
    ]
    stop_daemon(address)
    gone(started)


def test_it_may_be_gone_while_it_is_looked_at(
    address: DaemonAddress, monkeypatch: pytest.MonkeyPatch
) -> None:
    started = start_daemon(address, wait_for=LISTENING)

    def status(process: psutil.Process) -> str:
        raise psutil.NoSuchProcess(process.pid)

    monkeypatch.setattr(psutil.Process, "status", status)
    stop_daemon(address)
    monkeypatch.undo()
    gone(started)


def test_where_a_profile_lies_it_stays_there(
    address: DaemonAddress, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "DEFAULT_FASTRTPS_PROFILES.xml").write_text(
        '<?xml version="1.0"?><profiles xmlns="http://www.eprosima.com/XMLSchemas/'
        'fastRTPS_Profiles"></profiles>'
    )
    started = start_daemon(address)
    status = json.loads(ask(address, STATUS_METHOD))
    assert (Path("/proc") / str(started.pid) / "cwd").readlink() == tmp_path
    assert status["transports"] == ""
    stop_daemon(address)
    gone(started)


def test_only_one_of_many_starts_starts_one(address: DaemonAddress) -> None:
    found: list[StartedDaemon] = []

    def start() -> None:
        found.append(start_daemon(address))

    threads = [threading.Thread(target=start) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(found) == 4
    assert len({started.pid for started in found}) == 1
    (winner,) = [started for started in found if started.started]
    stop_daemon(address)
    assert gone(winner) == 0


@pytest.mark.parametrize("kind", ["other", "silent", "impostor"])
def test_another_owner_of_the_port_is_named(
    address: DaemonAddress, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    monkeypatch.setattr(port, "PROBE_TIMEOUT", 0.5)
    monkeypatch.setattr(port.find_owner, "__defaults__", (0.5,))
    with occupied(kind, address.port) as process:
        message = f"process {process.pid} .*has the daemon's port {address.port}: "
        for action in (start_daemon, stop_daemon):
            with pytest.raises(PortHeldError, match=message):
                action(address)
        assert process.poll() is None


def test_a_port_in_time_wait_is_waited_for(other_domain: int) -> None:
    """As clients of ros2cli's daemon leave it; the kernel's minute is not waited for here."""
    notices: list[str] = []

    class NoticeError(Exception):
        pass

    def notify(text: str) -> None:
        notices.append(text)
        raise NoticeError

    address = DaemonAddress(other_domain)
    with occupied("time_wait", address.port) as process:
        with socket.create_connection((address.host, address.port)) as client:
            client.sendall(b"GET / HTTP/1.0\r\n\r\n")
            while client.recv(4096):  # to the end: the side that closes first waits
                pass
        with pytest.raises(NoticeError):
            start_daemon(address, notify=notify)
        assert process.wait(WAIT) == 0
    assert f"port {address.port}" in notices[0]
    assert "TIME_WAIT" in notices[0]


def test_a_stock_daemon_is_replaced(address: DaemonAddress) -> None:
    with occupied("stock", address.port) as process:
        started = start_daemon(address)
        assert started.started
        assert started.messages == (f"took over from ros2cli's daemon (pid {process.pid})",)
        assert process.wait(WAIT) == 0
    assert ask(address, "get_name").startswith("_ros2cli_daemon_")
    stop_daemon(address)
    gone(started)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
def test_a_signal_ends_it_in_order(address: DaemonAddress, number: signal.Signals) -> None:
    started = start_daemon(address, wait_for=LISTENING)
    os.kill(started.pid, number)
    assert gone(started) == 0
    assert stock_can_start(address)


def test_a_kill_leaves_the_port_free_although_clients_are_connected(
    address: DaemonAddress,
) -> None:
    started = start_daemon(address)
    clients = [socket.create_connection((address.host, address.port)) for _ in range(10)]
    ask(address, "get_name")
    os.kill(started.pid, signal.SIGKILL)
    assert gone(started) == -signal.SIGKILL
    sweep_after_a_kill()
    assert stock_can_start(address)
    for client in clients:
        client.close()
    again = start_daemon(address, wait_for=LISTENING)
    assert again.started
    stop_daemon(address)
    assert gone(again) == 0


def test_other_settings_are_reported_and_a_restart_takes_them(
    address: DaemonAddress, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = start_daemon(address, wait_for=LISTENING)
    monkeypatch.setenv("ROS_STATIC_PEERS", "127.0.0.1")
    kept = start_daemon(address)
    assert not kept.started
    assert kept.messages == ("ROS_STATIC_PEERS: the daemon has not set, here it is 127.0.0.1",)
    second = start_daemon(address, restart=True, wait_for=LISTENING)
    assert second.started
    assert second.pid != first.pid
    assert gone(first) == 0
    assert find_owner(address).status["settings"]["ROS_STATIC_PEERS"] == "127.0.0.1"
    # Any user of the machine may ask it, and variables may hold passwords.
    assert "127.0.0.1" not in ask(address, STATUS_METHOD)
    assert start_daemon(address).messages == ()
    stop_daemon(address)
    gone(second)


@contextlib.contextmanager
def announcing(*names: str) -> Iterator[subprocess.Popen[bytes]]:
    """A process that announces nodes without endpoints; `communicate` ends it in order."""
    command = [sys.executable, "-m", "tests.graph_daemon.ghost", *names]
    with subprocess.Popen(command, stdin=subprocess.PIPE) as process:
        try:
            yield process
        finally:
            process.kill()  # a stopped one, too


def test_nodes_of_a_participant_that_has_ended_are_forgotten(address: DaemonAddress) -> None:
    """The middleware never does: such a node has no participant whose end would be noticed."""
    started = start_daemon(address)

    def nodes() -> set[str]:
        return {name for name, _ in ask(address, "get_node_names_and_namespaces")}

    with announcing("lasting") as lasting, announcing("ghost") as dead:
        until(lambda: nodes() >= {"lasting", "ghost"}, "both nodes")
        dead.communicate(timeout=WAIT)
        seen_at = time.monotonic()
        until(lambda: time.monotonic() - seen_at > LONGEST_DOUBT - 2, "the time before the doubts")
        assert nodes() >= {"lasting", "ghost", "announcer"}
        # A process that is discovered late is waited for.
        lasting.send_signal(signal.SIGSTOP)
        doubted = re.compile("/ghost.* may not exist any more")  # often both of them
        until(lambda: doubted.search(log_path(address).read_text()) is not None, "the doubts")
        began = time.monotonic()
        while "ghost" in (seen := nodes()):
            if time.monotonic() - began > REPLACEMENT_TIME + 0.5:
                lasting.send_signal(signal.SIGCONT)
            assert time.monotonic() - began < WAIT
        lasting.send_signal(signal.SIGCONT)
        assert "announcer" in seen
        until(lambda: "lasting" in nodes(), "the node without endpoints")
        lasting.communicate(timeout=WAIT)
    stop_daemon(address)
    gone(started)


def test_what_is_doubtful_for_long_is_looked_at_anew_once() -> None:
    doubts = Doubts()
    one, other = ("a", "/"), ("b", "/x")

    def old(now: float, *doubtful: tuple[str, str]) -> list[str]:
        doubts.look(now, frozenset(doubtful))
        return doubts.take_old(now)

    assert old(0, one) == []
    assert old(24, one, other) == []
    assert doubts.take_old(25) == ["/a"]
    assert old(48, one, other) == []
    assert doubts.take_old(49) == ["/x/b"]
    assert old(100, one, other) == []
    assert old(101) == [], "it was gone"
    assert old(102, one) == []
    assert old(127, one) == ["/a"]


def test_it_ends_without_requests(address: DaemonAddress) -> None:
    started = start_daemon(address, idle_timeout=1.0, wait_for=LISTENING)
    assert gone(started) == 0
    assert stock_can_start(address)


def test_one_that_cannot_start_is_reported_with_its_reason(
    address: DaemonAddress, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    broken = tmp_path / "rclpy"
    broken.mkdir()
    (broken / "__init__.py").write_text('raise ImportError("this rclpy is broken")')
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    with pytest.raises(DaemonStartError, match="this rclpy is broken"):
        start_daemon(address, wait_for=LISTENING)
    assert stock_can_start(address)


@pytest.mark.parametrize(
    ("environment", "folder"),
    [
        ({"HOME": "/h"}, "/h/.ros/log"),
        ({"HOME": "/h", "ROS_HOME": "/r"}, "/r/log"),
        ({"HOME": "/h", "ROS_HOME": "/r", "ROS_LOG_DIR": "~/l"}, "/h/l"),
    ],
)
def test_its_log_is_where_ros_writes_its_own(
    address: DaemonAddress, environment: Mapping[str, str], folder: str
) -> None:
    assert log_path(address, environment).parent == Path(folder)


def test_without_a_place_for_its_log_it_starts_all_the_same(
    address: DaemonAddress, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path))
    log_path(address).mkdir()
    started = start_daemon(address, wait_for=LISTENING)
    stop_daemon(address)
    assert gone(started) == 0


@pytest.mark.parametrize(
    "put", [Path.symlink_to, Path.hardlink_to, lambda path, _: os.mkfifo(path)]
)
def test_what_stands_at_the_place_of_its_log_is_replaced_and_neither_followed_nor_read(
    put: Callable[[Path, Path], None],
    address: DaemonAddress,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    """In a shared folder, another user may have put it there."""
    precious = tmp_path / "precious"
    precious.write_text("precious")
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path))
    put(log_path(address), precious)
    started = start_daemon(address, wait_for=LISTENING)
    stop_daemon(address)
    assert gone(started) == 0
    assert precious.read_text() == "precious"
    assert log_path(address).is_file()
    assert not log_path(address).is_symlink()


def test_a_client_in_another_thread_is_answered_while_it_ends(address: DaemonAddress) -> None:
    """Every question up to the end is answered or refused, never left hanging."""
    started = start_daemon(address)
    answers: list[object] = []

    def hammer() -> None:
        while True:
            try:
                answers.append(ask(address, "get_namespace"))
            except OSError:
                return

    threads = [threading.Thread(target=hammer) for _ in range(4)]
    for thread in threads:
        thread.start()
    until(lambda: len(answers) > 50, "50 answers")
    stop_daemon(address)
    for thread in threads:
        thread.join(WAIT)
        assert not thread.is_alive()
    assert set(answers) == {"/"}
    assert gone(started) == 0


def test_in_the_foreground_it_serves_until_it_is_stopped(address: DaemonAddress) -> None:
    program = Path(sys.executable).parent / "play-launch"
    process = subprocess.Popen([program, "daemon", "run"], stdout=subprocess.PIPE, text=True)
    with process:
        assert process.stdout is not None
        try:
            assert process.stdout.readline() == f"serving {address.url}\n"
            assert find_owner(address).pid == process.pid
            process.send_signal(signal.SIGINT)
            assert process.wait(WAIT) == 0
        finally:
            process.kill()
    assert stock_can_start(address)
