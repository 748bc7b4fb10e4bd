"""The threads of a container that wait for its nodes' processes."""

from __future__ import annotations

import os
from pathlib import Path
from signal import SIGCONT, SIGSTOP
from typing import TYPE_CHECKING

import pytest
from std_msgs.msg import String

from tests.support.isolated import MODES, start, survives
from tests.support.ros import Probe

if TYPE_CHECKING:
    from tests.support.control_peer import Container, StartContainer

NODES = 20
LOOKS = 50


def states(container: Container) -> str:
    """One letter for each thread of the container, as `ps` has it."""
    letters = ""
    for task in Path(f"/proc/{container.process.pid}/task").iterdir():
        try:
            letters += (task / "stat").read_text().rsplit(")", 1)[1].split()[0]
        except (FileNotFoundError, ProcessLookupError):
            continue  # it has just ended
    return letters


@pytest.mark.parametrize("mode", MODES)
def test_idle_nodes_are_no_load(spawn: StartContainer, mode: str) -> None:
    container = start(spawn, mode)
    with survives(container):
        for i in range(NODES):
            container.loaded("Echo", node_name=f"idle_{i}")
        seen = [states(container) for _ in range(LOOKS)]
        assert all(len(letters) > NODES for letters in seen)
        # The kernel counts D like R. A thread may be seen in D for a moment, when it waits for
        # memory; those that wait for a node would be at each look.
        assert sum(letters.count("D") for letters in seen) < LOOKS, seen


def test_a_container_stops_and_goes_on(spawn: StartContainer) -> None:
    container = start(spawn)
    with survives(container), Probe() as probe:
        talkers = [container.loaded("Talker", node_name=f"talker_{i}") for i in range(3)]
        for _ in range(5):
            os.kill(container.process.pid, SIGSTOP)
            # As a shell waits after Ctrl-Z: until every thread has stopped.
            stopped = os.waitid(os.P_PID, container.process.pid, os.WSTOPPED)
            assert stopped is not None
            assert stopped.si_status == SIGSTOP
            os.kill(container.process.pid, SIGCONT)
        assert len(container.status(*(t.unique_id for t in talkers)).nodes) == len(talkers)
        probe.collect(String, "/chatter", 3)
