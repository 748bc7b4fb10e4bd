"""What descriptions are made of."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any


class LaunchDescriptionEntity:
    def visit(self, context: Any) -> Any:
        raise NotImplementedError


class LaunchDescription(LaunchDescriptionEntity):
    def __init__(self, entities: Iterable[Any] = ()) -> None:
        self.entities = list(entities)

    def visit(self, context: Any) -> Any:
        return self.entities

    def get_launch_arguments(self) -> list[Any]:
        return [each for each in self.entities if type(each).__name__ == "DeclareLaunchArgument"]


class Action(LaunchDescriptionEntity):
    def __init__(self, *, condition: Any = None) -> None:
        self.condition = condition

    def describe(self) -> str:
        return type(self).__name__

    def visit(self, context: Any) -> Any:
        return self.execute(context)

    def execute(self, context: Any) -> Any:
        raise NotImplementedError
