"""Components of rclcpp: alone, beside native ones, and those of the demonstrations of ROS."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from play_launch_msgs.msg import ComponentEvent, ControlUnload, NodeStatus
from rcl_interfaces.msg import Log
from rcl_interfaces.srv import GetParameters, ListParameters
from std_msgs.msg import String

from tests.container.conftest import prefix_of
from tests.support.control_peer import StartContainer
from tests.support.isolated import ALL_MODES, MODES, start, survives
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


all_modes = pytest.mark.parametrize("mode", ALL_MODES)


@all_modes
@pytest.mark.needs_packages("composition")
def test_service_and_client(spawn: StartContainer, mode: str, probe: Probe) -> None:
    container = start(spawn, mode)
    container.loaded("composition::Server", package="composition")
    container.loaded("composition::Client", package="composition")
    probe.spin_until(
        lambda: "Got result: [5]" in container.log.read_text(), 30.0, "the client's result"
    )
    assert container.shut_down() == 0, container.log.read_text()


@all_modes
@pytest.mark.needs_packages("demo_nodes_cpp")
def test_parameters(spawn: StartContainer, mode: str, probe: Probe, tmp_path: Path) -> None:
    package = "demo_nodes_cpp"
    # Version 0.33.5 of that package builds its components, but enters none in the index.
    index = tmp_path / "share" / "ament_index" / "resource_index" / "rclcpp_components"
    index.mkdir(parents=True)
    library = f"{prefix_of(package)}/lib/libparameter_blackboard_library.so"
    (index / package).write_text(f"demo_nodes_cpp::ParameterBlackboard;{library}\n")
    path = os.pathsep.join([os.fspath(tmp_path), os.environ["AMENT_PREFIX_PATH"]])
    container = start(spawn, mode, environment={"AMENT_PREFIX_PATH": path})
    node = container.loaded("demo_nodes_cpp::ParameterBlackboard", package=package)
    assert node.full_node_name == "/parameter_blackboard"
    again = container.loaded(
        "demo_nodes_cpp::ParameterBlackboard",
        package=package,
        node_name="board",
        node_namespace="/wall",
        parameters={"colour": "blue"},
    )
    assert again.full_node_name == "/wall/board"
    answer = probe.call(
        GetParameters, "/wall/board/get_parameters", GetParameters.Request(names=["colour"])
    )
    assert answer.values[0].string_value == "blue"
    names = probe.call(
        ListParameters, "/parameter_blackboard/list_parameters", ListParameters.Request()
    )
    assert "use_sim_time" in names.result.names
    assert container.shut_down() == 0, container.log.read_text()


@pytest.mark.parametrize("mode", ALL_MODES)
def test_the_sink_gets_the_very_image(
    spawn: StartContainer, components: str, mode: str, probe: Probe
) -> None:
    container = start(spawn, mode)
    by_pointer = {"use_intra_process_comms": True}
    sink = container.loaded("ImageSink", package=components, extra_arguments=by_pointer)
    source = container.loaded("ImageSource", package=components, extra_arguments=by_pointer)
    for verdict in probe.collect(String, "/verdict", 20, timeout=60.0):
        made_by, made_at, seen_by, seen_at = verdict.data.split()
        assert (int(made_by), int(seen_by)) == (source.pid, sink.pid)
        assert made_at == seen_at
    assert (source.pid == sink.pid) == (not mode.startswith("isolated"))
    assert container.shut_down() == 0, container.log.read_text()


@pytest.mark.parametrize("mode", ["standard", "isolated"])
def test_without_intra_process_it_is_a_copy(
    spawn: StartContainer, components: str, mode: str, probe: Probe
) -> None:
    container = start(spawn, mode)
    container.loaded("ImageSink", package=components)
    container.loaded("ImageSource", package=components)
    for verdict in probe.collect(String, "/verdict", 3, timeout=60.0):
        _, made_at, _, seen_at = verdict.data.split()
        assert made_at != seen_at
    assert container.shut_down() == 0, container.log.read_text()


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
def test_a_destroyed_node_is_not_called(spawn: StartContainer, components: str, mode: str) -> None:
    container = start(spawn, mode)
    container.loaded("Watcher", package=components)
    gone = container.loaded("Watcher", package=components, node_name="gone")
    container.send(ControlUnload(unique_id=gone.unique_id))
    container.event(UNLOADED, unique_id=gone.unique_id)
    assert container.shut_down() == 0, container.log.read_text()
