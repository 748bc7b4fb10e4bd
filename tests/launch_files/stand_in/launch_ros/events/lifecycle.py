"""Events of managed nodes, which no test of the stand-in uses."""

from __future__ import annotations

from typing import Any

from launch.events import Event


class ChangeState(Event):
    valid_transitions: dict[int, str] = {}  # noqa: RUF012


class StateTransition(Event):
    def __init__(self, *, action: Any, msg: Any) -> None:
        raise NotImplementedError
