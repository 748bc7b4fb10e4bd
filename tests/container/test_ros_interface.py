"""The services and the topic of a supervised container, seen by plain rclpy."""

from __future__ import annotations

from typing import TYPE_CHECKING

from play_launch_msgs.msg import ComponentEvent
from rcl_interfaces.srv import GetParameters

from tests.support.ros import LATCHED, Probe

if TYPE_CHECKING:
    from tests.support.control_peer import Container, StartContainer

LOADED, LOADING = ComponentEvent.LOADED, ComponentEvent.LOADING
EVENTS = "/container/_container/component_events"


def test_events_before_the_topic_was_offered_are_published(container: Container) -> None:
    loaded = container.loaded("Talker", node_name="early")
    with Probe() as probe:
        events = probe.collect(ComponentEvent, EVENTS, count=2, qos=LATCHED)
        assert [(e.event_type, e.unique_id) for e in events] == [
            (LOADING, loaded.unique_id),
            (LOADED, loaded.unique_id),
        ]
        assert probe.nodes() == [("/early", loaded.unique_id)]
        request = GetParameters.Request(names=["thread_num"])
        answer = probe.call(GetParameters, "/container/get_parameters", request)
        assert answer.values[0].integer_value == 0


def test_a_container_without_loads_offers_its_services(container: Container) -> None:
    assert container.status().nodes == []
    with Probe() as probe:
        assert probe.nodes() == []


def test_it_ends_in_order_before_it_has_offered_anything(spawn: StartContainer) -> None:
    container = spawn("--isolated")
    container.process.terminate()
    assert container.process.wait(20) == 0, container.log.read_text()
