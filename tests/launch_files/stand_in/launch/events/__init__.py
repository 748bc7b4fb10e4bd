"""Events."""

from __future__ import annotations

from typing import Any


class Event:
    @property
    def name(self) -> str:
        return type(self).__name__


class Shutdown(Event):
    def __init__(self, *, reason: str = "reason not given") -> None:
        self.reason = reason


class IncludeLaunchDescription(Event):
    def __init__(self, launch_description: Any) -> None:
        self.launch_description = launch_description


def matches_action(action: Any) -> Any:
    return lambda other: other is action
