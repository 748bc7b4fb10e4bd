"""Actions that no test of the stand-in uses."""

from __future__ import annotations

from typing import Any

from launch.actions import ExecuteProcess, TimerAction
from launch.entities import Action


class Node(ExecuteProcess):
    def _create_params_file_from_dict(self, values: Any) -> str:
        raise NotImplementedError


class LifecycleNode(Node):
    pass


class ComposableNodeContainer(Node):
    pass


class LoadComposableNodes(Action):
    pass


class ROSTimer(TimerAction):
    pass


class LifecycleTransition(Action):
    pass


class SetUseSimTime(Action):
    pass
