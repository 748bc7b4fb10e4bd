"""Native and rclcpp components in one container."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from play_launch_msgs.msg import ComponentEvent, ControlUnload
from rcl_interfaces.msg import Log
from std_msgs.msg import String

from tests.support.isolated import ALL_MODES, MODES, start, survives

if TYPE_CHECKING:
    from tests.support.control_peer import StartContainer
    from tests.support.ros import Probe


@pytest.mark.parametrize("mode", ALL_MODES)
def test_they_hear_each_other(
    spawn: StartContainer, components: str, mode: str, probe: Probe
) -> None:
    container = start(spawn, mode)
    container.loaded("Talker", package=components, node_name="from_rclcpp")
    container.loaded("Talker", node_name="native", parameters={"rate": 50.0})
    container.loaded("Listener", node_name="ear")
    heard = probe.listen(String, "/chatter")
    probe.spin_until(
        lambda: {m.data.isdigit() for m in heard} == {True, False}, 30.0, "both talkers"
    )
    assert container.shut_down() == 0, container.log.read_text()


@pytest.mark.parametrize("mode", ALL_MODES)
def test_all_nodes_share_one_participant(
    spawn: StartContainer, components: str, mode: str, probe: Probe
) -> None:
    container = start(spawn, mode)
    container.loaded("Talker", package=components, node_name="from_rclcpp")
    container.loaded("Talker", node_name="native")
    probe.spin_until(lambda: probe.node.count_publishers("/chatter") == 2, 30.0, "both talkers")
    guids = {
        bytes(info.endpoint_gid)[:12]
        for info in probe.node.get_publishers_info_by_topic("/chatter")
    }
    assert len(guids) == 1  # a participant's part of an endpoint's id
    assert container.shut_down() == 0, container.log.read_text()


@pytest.mark.parametrize("mode", MODES)
def test_a_crash_of_one_kind_spares_the_other(
    spawn: StartContainer, components: str, mode: str, probe: Probe
) -> None:
    container = start(spawn, mode)
    with survives(container):
        container.loaded("Talker", package=components)
        container.loaded("Talker", node_name="native")
        for package in (components, "play_launch_demo"):
            crasher = container.loaded(
                "Crasher", package=package, parameters={"how": "segv", "after": 0.001}
            )
            container.event(ComponentEvent.CRASHED, unique_id=crasher.unique_id)
        heard = probe.listen(String, "/chatter")
        probe.spin_until(
            lambda: {m.data.isdigit() for m in heard} == {True, False}, 30.0, "both talkers"
        )
        assert container.status().leaked == 0


def test_both_log_to_rosout(spawn: StartContainer, components: str, probe: Probe) -> None:
    container = start(spawn, "standard")
    logs = probe.listen(Log, "/rosout")
    names = ["native", "from_rclcpp"]
    container.loaded("Talker", node_name="native", log_level=10)
    talker = container.loaded("Talker", package=components, node_name="from_rclcpp", log_level=10)
    probe.spin_until(lambda: set(names) <= {log.name for log in logs}, 30.0, "a line of each")
    container.send(ControlUnload(unique_id=talker.unique_id))
    container.event(ComponentEvent.UNLOADED, unique_id=talker.unique_id)
    assert container.shut_down() == 0, container.log.read_text()
