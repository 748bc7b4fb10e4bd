"""What is said of registered sessions that do not answer, and which processes are suggested."""

from __future__ import annotations

import os
import socket
import subprocess
from typing import TYPE_CHECKING

import pytest

from play_launch.control.client import NoSessionError, connect
from play_launch.control.place import CONTROL_SOCKET, LINKS, registered
from tests.control.links import put_link

if TYPE_CHECKING:
    from pathlib import Path


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
    with pytest.raises(NoSessionError, match=r"no session is running; (.|\n)*was killed"):
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
    assert str(refused.value) == "no session is running; start one with play-launch replay"
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
