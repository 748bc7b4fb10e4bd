"""Unloading while callbacks run."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from play_launch_msgs.msg import ComponentEvent, ControlUnload, NodeStatus
from std_msgs.msg import String

from tests.support.isolated import ALL_MODES, start

if TYPE_CHECKING:
    from tests.support.control_peer import StartContainer
    from tests.support.ros import Probe

UNLOADED = ComponentEvent.UNLOADED


def test_it_waits_for_a_running_callback(
    spawn: StartContainer, components: str, probe: Probe
) -> None:
    container = start(spawn, "mt", "--thread_num", "3")
    patient = container.loaded("Patient", package=components)
    container.loaded("Releaser", package=components)
    busy = probe.listen(String, "/busy")
    go = probe.node.create_publisher(String, "/go", 1)
    leave = probe.node.create_publisher(String, "/leave", 1)
    probe.spin_until(
        lambda: (
            go.get_subscription_count() > 0
            and leave.get_subscription_count() > 0
            and probe.node.count_publishers("/busy") > 0
        ),
        30.0,
        "the nodes",
    )
    go.publish(String())
    probe.spin_until(lambda: bool(busy), 30.0, "the callback")
    container.send(ControlUnload(unique_id=patient.unique_id))
    (node,) = container.status(patient.unique_id).nodes
    assert node.state == NodeStatus.UNLOADING
    leave.publish(String())
    container.event(UNLOADED, unique_id=patient.unique_id)
    probe.spin_until(lambda: len(busy) == 2, 30.0, "the callback's end")
    assert container.shut_down() == 0, container.log.read_text()


@pytest.mark.parametrize("mode", ALL_MODES)
def test_nobody_calls_a_node_that_is_destroyed(
    spawn: StartContainer, components: str, mode: str
) -> None:
    container = start(spawn, mode)
    container.loaded("Watcher", package=components)
    gone = container.loaded("Watcher", package=components, node_name="gone")
    container.send(ControlUnload(unique_id=gone.unique_id))
    container.event(UNLOADED, unique_id=gone.unique_id)
    assert container.shut_down() == 0, container.log.read_text()
