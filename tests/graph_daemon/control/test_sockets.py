"""Who holds a port, read from the kernel's tables."""

from __future__ import annotations

import os
import socket
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from play_launch.graph_daemon.control.sockets import (
    Holder,
    age_of,
    holder_of,
    listening_inodes,
    parse_tcp,
    read_tcp,
    time_wait_ports,
)


@given(st.text())
def test_what_is_no_table_has_no_entries(text: str) -> None:
    for entry in parse_tcp(text):
        assert entry.port >= 0


def test_a_listener_of_ours_is_ours() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
        (inode,) = listening_inodes(read_tcp(), port)
        assert inode == os.fstat(listener.fileno()).st_ino
        holder = holder_of(port)
        assert holder is not None
        assert holder.pid == os.getpid()
        assert sys.executable.rsplit("/", 1)[-1] in str(holder)
    assert holder_of(port) is None


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
    assert peer in time_wait_ports(read_tcp(), port)


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
