"""Upstream's demonstration components, unchanged, in all four modes."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import pytest
from rcl_interfaces.srv import GetParameters, ListParameters

from tests.container.conftest import prefix_of
from tests.support.isolated import ALL_MODES, start

if TYPE_CHECKING:
    from pathlib import Path

    from tests.support.control_peer import StartContainer
    from tests.support.ros import Probe

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
