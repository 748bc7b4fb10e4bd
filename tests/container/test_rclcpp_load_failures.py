"""Whatever keeps a component from being loaded is told, and costs nobody else anything."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import pytest
from play_launch_msgs.msg import ComponentEvent
from std_msgs.msg import String

from tests.support.isolated import start

if TYPE_CHECKING:
    from pathlib import Path

    from tests.support.control_peer import Container, StartContainer
    from tests.support.ros import Probe

both = pytest.mark.parametrize("mode", ["standard", "isolated"])


def failure(container: Container, plugin: str, package: str, **fields: Any) -> str:
    """Load what cannot be loaded; the reason."""
    container.load(plugin, package=package, **fields)
    event = container.event(ComponentEvent.LOAD_FAILED)
    return str(event.error_message)


@both
def test_reasons(spawn: StartContainer, components: str, mode: str, probe: Probe) -> None:
    container = start(spawn, mode)
    container.loaded("Talker", package=components)

    reason = failure(container, "Talker", "no_such_package")
    assert "package 'no_such_package' has no components" in reason
    assert "play_launch_components, rclcpp_components" in reason

    reason = failure(container, "NoSuchClass", components)
    assert "has no component 'test_components::NoSuchClass'" in reason
    assert "test_components::Talker" in reason

    reason = failure(container, "NeverRegistered", components)
    assert "registers only" in reason
    assert "RCLCPP_COMPONENTS_REGISTER_NODE" in reason

    reason = failure(container, "Unresolved", components)
    assert "cannot load library" in reason
    assert "defined_nowhere" in reason

    reason = failure(container, "ThrowingConstructor", components)
    assert "no camera is connected" in reason

    reason = failure(container, "Talker", components, parameters={"rate": "fast"})
    assert "rate" in reason
    assert "type" in reason

    reason = failure(container, "Talker", components, node_name="not a name")
    assert "not a name" in reason

    reason = failure(container, "Talker", components, remap_rules=["nonsense"])
    assert "nonsense" in reason

    for name in ("use_intra_process_comms", "forward_global_arguments"):
        reason = failure(container, "Talker", components, extra_arguments={name: "yes"})
        assert reason == f"Extra component argument '{name}' must be a boolean"

    probe.collect(String, "/chatter", 5, timeout=60.0)
    assert container.shut_down() == 0, container.log.read_text()


@both
def test_a_missing_library_and_a_damaged_index(
    spawn: StartContainer, components: str, mode: str, tmp_path: Path
) -> None:
    index = tmp_path / "share" / "ament_index" / "resource_index" / "rclcpp_components"
    index.mkdir(parents=True)
    (index / "gone").write_text("gone::Node;lib/libgone.so\n")
    (index / "damaged").write_text("damaged::Node\n")
    path = os.pathsep.join([os.fspath(tmp_path), os.environ["AMENT_PREFIX_PATH"]])
    container = start(spawn, mode, environment={"AMENT_PREFIX_PATH": path})
    reason = failure(container, "gone::Node", "gone")
    assert "cannot load library" in reason
    assert f"{tmp_path}/lib/libgone.so" in reason
    reason = failure(container, "damaged::Node", "damaged")
    assert "is not of the form class;library" in reason
    container.loaded("Talker", package=components)
    assert container.shut_down() == 0, container.log.read_text()


@both
def test_a_half_made_node_leaves_the_graph(
    spawn: StartContainer, components: str, mode: str, probe: Probe
) -> None:
    container = start(spawn, mode)
    reason = failure(
        container,
        "ThrowingConstructor",
        components,
        parameters={},
        extra_arguments={"use_intra_process_comms": True},
    )
    assert "ThrowingConstructor" in reason
    container.loaded("Talker", package=components)
    probe.spin_until(
        lambda: (
            "talker" in probe.node.get_node_names()
            and "throwing_constructor" not in probe.node.get_node_names()
        ),
        30.0,
        "the graph without the half",
    )
    assert container.shut_down() == 0, container.log.read_text()
