"""What composable nodes become: the load requests that launch_ros would send."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from launch.utilities import normalize_to_list_of_substitutions, perform_substitutions
from launch_ros.actions import ComposableNodeContainer
from launch_ros.actions.load_composable_nodes import get_composable_node_load_request
from launch_ros.utilities import evaluate_parameters, to_parameters_list

from play_launch.launch_files.records import Composable, Parameter, Values
from play_launch.launch_files.ros_launch.rcl_parameters import message_parameter

if TYPE_CHECKING:
    from collections.abc import Iterable

    from play_launch.launch_files.records import Source
    from play_launch.launch_files.ros_launch.scene import Scene


def record_composables(scene: Scene, action: Any) -> list[Composable]:
    """Return the records of the nodes that a LoadComposableNodes action loads."""
    container = _container(scene, action)
    found = []
    for description in action._LoadComposableNodes__composable_node_descriptions:  # noqa: SLF001
        # The request takes the place of a temporary file whose description is gone with it.
        request = get_composable_node_load_request(description, scene.context)
        if request is not None:
            found.append(_record(scene, action, description, request, container))
    return found


def _container(scene: Scene, action: Any) -> str:
    target = action._LoadComposableNodes__target_container  # noqa: SLF001
    if isinstance(target, ComposableNodeContainer):
        name = target.node_name
    else:
        name = perform_substitutions(scene.context, normalize_to_list_of_substitutions(target))
    return name if name.startswith("/") else f"/{name}"


def _record(
    scene: Scene, action: Any, description: Any, request: Any, container: str
) -> Composable:
    places = scene.places
    place = places.of_part(description)
    return Composable(
        id=scene.next_id("c"),
        origin=places.origin(place if place.file else places.of_part(action)),
        start=list(scene.causes.now),
        package=request.package_name,
        plugin=request.plugin_name,
        name=request.node_name,
        namespace=request.node_namespace,
        container=container,
        remappings=[_pair(rule) for rule in request.remap_rules],
        sources=list(_sources(scene, description, request)),
        parameters=_parameters(request.parameters),
        extra_arguments=_parameters(request.extra_arguments),
    )


def _pair(rule: str) -> tuple[str, str]:
    source, _, target = rule.partition(":=")
    return source, target


def _parameters(messages: Iterable[Any]) -> list[Parameter]:
    """Return what a component gets of a request: of a name that stands twice, the last value."""
    found = (message_parameter(message) for message in messages)
    return list({each.name: each for each in found if each is not None}.values())


def _sources(scene: Scene, description: Any, request: Any) -> Iterable[Source]:
    """Return the sources of the parameters in their order, those of the context first."""
    for each in scene.context.launch_configurations.get("global_params", None) or ():
        if isinstance(each, tuple):
            yield from _values(scene, request, {each[0]: each[1]})
        else:
            yield scene.parameter_file(str(each))
    for each in evaluate_parameters(scene.context, description.parameters or ()):
        if isinstance(each, dict):
            yield from _values(scene, request, each)
        else:
            yield scene.parameter_file(str(each))


def _values(scene: Scene, request: Any, values: dict[str, Any]) -> Iterable[Values]:
    names = (request.node_name, request.node_namespace)
    found = to_parameters_list(scene.context, *names, [values])
    yield Values(tuple(_parameters(each.to_parameter_msg() for each in found)))
