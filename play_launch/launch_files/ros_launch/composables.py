"""What composable nodes become: the load requests that launch_ros would send."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from launch.utilities import normalize_to_list_of_substitutions, perform_substitutions
from launch_ros.actions import ComposableNodeContainer, load_composable_nodes

from play_launch.launch_files.records import Composable
from play_launch.launch_files.ros_launch.rcl_parameters import parameter_of

if TYPE_CHECKING:
    from collections.abc import Iterable

    from play_launch.launch_files.records import Parameter, ParameterFile
    from play_launch.launch_files.ros_launch.scene import Scene


class Composables:
    """Makes the records of one evaluation.

    Parameters are taken before launch_ros makes messages of them, which takes longer than all the
    rest. Their files are looked at then as well, as temporary ones do not stay.
    """

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._taken: list[tuple[list[Parameter], list[ParameterFile]]] = []
        self._to_parameters_list = load_composable_nodes.to_parameters_list
        load_composable_nodes.to_parameters_list = self._take

    def _take(
        self, context: Any, name: str, namespace: str, evaluated: Iterable[Any]
    ) -> list[object]:
        sources = list(evaluated)
        found = self._to_parameters_list(context, name, namespace, sources)
        # As they are given; launch_ros resolves links in those of the context, which come first.
        for number, each in enumerate(context.launch_configurations.get("global_params") or ()):
            if not isinstance(each, tuple) and number < len(sources):
                sources[number] = each
        files = [
            self._scene.parameter_file(str(each)) for each in sources if not isinstance(each, dict)
        ]
        self._taken.append((_last_of_each(found), files))
        return []

    def of(self, action: Any) -> list[Composable]:
        """Return the records of the nodes that a LoadComposableNodes action loads."""
        container = self._container(action)
        found = []
        for description in action._LoadComposableNodes__composable_node_descriptions:  # noqa: SLF001
            self._taken.clear()
            request = load_composable_nodes.get_composable_node_load_request(
                description, self._scene.context
            )
            if request is not None:
                found.append(self._record(action, description, request, container))
        return found

    def _container(self, action: Any) -> str:
        target = action._LoadComposableNodes__target_container  # noqa: SLF001
        if isinstance(target, ComposableNodeContainer):
            name = target.node_name
        else:
            parts = normalize_to_list_of_substitutions(target)
            name = perform_substitutions(self._scene.context, parts)
        return name if name.startswith("/") else f"/{name}"

    def _record(self, action: Any, description: Any, request: Any, container: str) -> Composable:
        has_extra = description.extra_arguments is not None
        extra = self._taken.pop()[0] if has_extra else []
        parameters, files = self._taken.pop() if self._taken else ([], [])
        places = self._scene.places
        place = places.of_part(description)
        return Composable(
            id=self._scene.next_id("c"),
            origin=places.origin(place if place.file else places.of_part(action)),
            start=list(self._scene.causes.now),
            package=request.package_name,
            plugin=request.plugin_name,
            name=request.node_name,
            namespace=request.node_namespace,
            container=container,
            remappings=[_pair(rule) for rule in request.remap_rules],
            sources=list(files),
            parameters=parameters,
            extra_arguments=extra,
        )


def _pair(rule: str) -> tuple[str, str]:
    source, _, target = rule.partition(":=")
    return source, target


def _last_of_each(parameters: Iterable[Any]) -> list[Parameter]:
    """Return what a component gets of a request: of a name that stands twice, the last value."""
    found = map(parameter_of, parameters)
    return list({each.name: each for each in found if each is not None}.values())
