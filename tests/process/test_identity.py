"""Which process is meant."""

from __future__ import annotations

import errno
import os
import signal
import subprocess

import pytest
from hypothesis import given
from hypothesis import strategies as st

from play_launch.process.identity import (
    NoSuchProcessError,
    ProcessHandle,
    ProcessIdentity,
    ProcessStat,
    StatFormatError,
    list_processes,
    parse_stat,
    read_stat,
)
from tests.process.programs import python


@given(
    command=st.text(st.characters(exclude_categories=["Cs"]), max_size=30),
    pid=st.integers(1, 2**22),
    start_time=st.integers(0, 2**63),
    state=st.sampled_from("RSDZTtXI"),
)
def test_stat_is_read_whatever_the_command_is_called(
    command: str, pid: int, start_time: int, state: str
) -> None:
    fields = [state, "1", "22", "33", *["0"] * 15, str(start_time), *["0"] * 30]
    stat = parse_stat(f"{pid} ({command}) {' '.join(fields)}\n")
    assert stat == ProcessStat(pid, command, state, 1, 22, 33, start_time)
    assert stat.is_alive == (state not in "ZX")


@pytest.mark.parametrize("text", ["", "12", "12 (a b", "12 (a) S 1 2", "x (a) S" + " 1" * 40])
def test_what_is_no_stat_is_refused(text: str) -> None:
    with pytest.raises(StatFormatError):
        parse_stat(text)


def test_own_stat_is_true() -> None:
    stat = read_stat(os.getpid())
    assert (stat.pid, stat.parent) == (os.getpid(), os.getppid())
    assert (stat.group, stat.session) == (os.getpgrp(), os.getsid(0))
    assert stat in [read_stat(other.pid) for other in list_processes() if other.pid == stat.pid]
    assert stat.identity.exists()
    assert stat.identity.is_alive()


def test_a_zombie_exists_and_is_not_alive() -> None:
    process = subprocess.Popen(python("pass"))
    identity = read_stat(process.pid).identity
    os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT)
    assert identity.exists()
    assert not identity.is_alive()
    process.wait()
    assert not identity.exists()
    with pytest.raises(NoSuchProcessError, match=str(process.pid)):
        read_stat(process.pid)


def test_a_handle_never_means_the_next_owner_of_a_pid() -> None:
    process = subprocess.Popen(["sleep", "600"])
    identity = read_stat(process.pid).identity
    with pytest.raises(NoSuchProcessError):
        ProcessHandle.open(ProcessIdentity(identity.pid, identity.start_time + 1))
    with ProcessHandle.open(identity) as handle:
        assert handle.send_signal(signal.SIGKILL)
        assert process.wait() == -signal.SIGKILL
        assert not handle.send_signal(signal.SIGKILL)
    with pytest.raises(NoSuchProcessError):
        ProcessHandle.open(identity)


def test_processes_that_proc_hides_are_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """As with ``mount -o hidepid=1``, where the processes of other users can be listed only."""
    opened = os.open

    def hiding(path: str, flags: int) -> int:
        if path == "/proc/1/stat":
            raise PermissionError(errno.EPERM, "Operation not permitted", path)
        return opened(path, flags)

    monkeypatch.setattr(os, "open", hiding)
    pids = {stat.pid for stat in list_processes()}
    assert os.getpid() in pids
    assert 1 not in pids
