"""Visits a launch description as `launch.LaunchService` does: each entity, then what it yields."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from launch import LaunchDescriptionEntity
from launch.actions import IncludeLaunchDescription

if TYPE_CHECKING:
    from play_launch.launch_files.ros_launch.happenings import Happenings
    from play_launch.launch_files.ros_launch.scene import Scene

_DEEPEST: Final = 50
"""How deep includes are nested; a file that includes itself has no end."""


class Visitor:
    """Visits depth first, and knows where it is."""

    happenings: Happenings

    def __init__(self, scene: Scene) -> None:
        self._scene = scene

    def visit(self, entity: Any) -> None:
        """Visit an entity and what it yields."""
        if not isinstance(entity, LaunchDescriptionEntity):
            raise TypeError(f"{entity!r}, where a part of a description is expected")
        places = self._scene.places
        place = places.of_part(entity)
        is_include = isinstance(entity, IncludeLaunchDescription) and bool(place.file)
        before, self.happenings.current_part = self.happenings.current_part, entity
        visited, places.visited = places.visited, place if place.file else places.visited
        if is_include:
            if len(places.includes) >= _DEEPEST:
                raise RuntimeError(f"includes are nested deeper than {_DEEPEST}")
            places.includes.append(place)
            self._scene.passed.append({str(name) for name in _names(entity)})
        try:
            for below in entity.visit(self._scene.context) or ():
                self.visit(below)
        except BaseException as error:
            places.annotate(error, place)
            raise
        finally:
            self.happenings.current_part = before
            places.visited = visited
            if is_include:
                places.includes.pop()
                self._scene.passed.pop()


def _names(include: Any) -> list[str]:
    return [
        "".join(getattr(part, "text", "") for part in name) if isinstance(name, list) else name
        for name, _ in include.launch_arguments
    ]
