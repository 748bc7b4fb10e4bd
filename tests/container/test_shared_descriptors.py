"""What a node does to the descriptors that it shares with its container and its neighbours."""

from __future__ import annotations

import time
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from play_launch_msgs.msg import ControlQuery
from std_msgs.msg import String

from play_launch.ros.fastdds.shared_memory import sweep
from tests.support.isolated import MODES, start, survives

if TYPE_CHECKING:
    from tests.support.control_peer import Container, StartContainer
    from tests.support.ros import Probe


def open_files(container: Container) -> set[str]:
    """What the container has open."""
    files = set()
    for entry in Path(f"/proc/{container.process.pid}/fd").iterdir():
        with suppress(FileNotFoundError):  # some are open for a moment only
            files.add(str(entry.readlink()))
    return files


@pytest.mark.parametrize("mode", MODES)
def test_garbage_in_low_descriptors_does_no_harm(
    spawn: StartContainer, mode: str, probe: Probe
) -> None:
    container = start(spawn, mode)
    with survives(container):
        container.loaded("Talker", parameters={"rate": 100.0})
        container.loaded("Vandal", parameters={"how": "garbage"})
        probe.collect(String, "/vandal", 5)  # it has done it, and goes on
        probe.collect(String, "/chatter", 5)
        container.loaded("Talker", node_name="another")
        assert not container.status().dead_locks


@pytest.mark.parametrize("mode", MODES)
def test_a_loop_over_low_descriptors_leaves_the_control_channel(
    spawn: StartContainer, mode: str
) -> None:
    container = start(spawn, mode)
    container.loaded("Vandal", parameters={"how": "close_low"})
    assert container.control_socket in open_files(container)
    container.status()
    container.shut_down()
    sweep()  # the lock files by which the container finds its segments are closed as well


def test_a_channel_that_is_closed_from_within_is_called_that(spawn: StartContainer) -> None:
    container = start(spawn)
    container.loaded("Vandal", parameters={"how": "close_all"})
    while container.control_socket in open_files(container):
        time.sleep(0.01)
    container.send(ControlQuery(query_id=1))  # wakes who waits for the closed socket
    assert container.wait() == 0
    sweep()
    log = container.log.read_text()
    assert "the control channel's descriptor was closed or replaced within this process" in log
    assert "supervisor is gone" not in log
