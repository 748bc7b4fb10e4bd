"""What a node does to the descriptors that it shares with its container and its neighbours."""

from __future__ import annotations

import os
import re
import time
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from play_launch_msgs.msg import ComponentEvent, ControlQuery
from std_msgs.msg import String

from play_launch.ros.fastdds.shared_memory import sweep
from tests.support.isolated import MODES, start, survives
from tests.support.ros import Probe

if TYPE_CHECKING:
    from tests.support.control_peer import Container, StartContainer

CRASHED = ComponentEvent.CRASHED

both_modes = pytest.mark.parametrize("mode", MODES)

NAMED = re.compile(r"^component_container: /vandal \(.*\) called (\w+)\(", re.MULTILINE)
"""The line that blames the node, with the function that it called."""

REFUSED = {
    "close_range": "close_range",
    "closefrom": "closefrom",
    "closefrom_at_the_end": "closefrom",
    "close_low": "close",
    "close_all": "close",
    "dup2": "dup2",
}
"""Ways that the container refuses, and the first call that it names."""


def open_files(container: Container) -> dict[str, str]:
    """What the container has open, by descriptor."""
    files = {}
    for entry in Path(f"/proc/{container.process.pid}/fd").iterdir():
        with suppress(FileNotFoundError):  # some are open for a moment only
            files[entry.name] = str(entry.readlink())
    return files


@both_modes
@pytest.mark.parametrize("how", [*REFUSED, "garbage"])
def test_a_node_cannot_spoil_the_container_s_descriptors(
    spawn: StartContainer, mode: str, how: str
) -> None:
    container = start(spawn, mode)
    with survives(container), Probe() as probe:
        container.loaded("Talker", parameters={"rate": 100.0})
        probe.collect(String, "/chatter", 5)
        before = open_files(container)
        vandal = container.loaded("Vandal", parameters={"how": how})
        probe.collect(String, "/vandal", 5)  # it has done it, and goes on
        assert before.items() <= open_files(container).items()
        probe.collect(String, "/chatter", 5)
        container.loaded("Talker", node_name="another")
        assert not container.status().dead_locks
        expected = [REFUSED[how]] if how in REFUSED else []
        assert NAMED.findall(container.log.read_text(errors="replace")) == expected
        os.kill(vandal.pid, 15)
        crashed = container.event(CRASHED, unique_id=vandal.unique_id)
        assert ("of its container" in crashed.error_message) == (how in REFUSED)


def test_a_channel_that_is_closed_from_within_is_called_that(spawn: StartContainer) -> None:
    container = start(spawn)
    container.loaded("Vandal", parameters={"how": "close_by_system_calls"})
    while container.control_socket in open_files(container).values():
        time.sleep(0.01)
    container.send(ControlQuery(query_id=1))  # wakes who waits for the closed socket
    assert container.wait() == 0
    sweep()  # the lock files by which the container finds its segments are closed as well
    log = container.log.read_text()
    assert "the control channel's descriptor was closed or replaced within this process" in log
    assert "supervisor is gone" not in log
