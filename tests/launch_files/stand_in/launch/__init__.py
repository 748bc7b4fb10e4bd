"""A stand-in for ROS's launch: descriptions, contexts, actions."""

from __future__ import annotations

import os
from collections import deque
from typing import Any

from . import logging
from .entities import Action, LaunchDescription, LaunchDescriptionEntity
from .event_handlers import EventHandler

__all__ = [
    "Action",
    "EventHandler",
    "LaunchContext",
    "LaunchDescription",
    "LaunchDescriptionEntity",
    "logging",
]


class LaunchContext:
    def __init__(self, *, argv: Any = (), noninteractive: bool = False) -> None:
        self.argv = argv
        self.noninteractive = noninteractive
        self.launch_configurations: dict[str, str] = {}
        self.environment = os.environ
        self.asyncio_loop: Any = None
        self._event_handlers: deque[Any] = deque()
        self._locals: list[dict[str, Any]] = [{}]

    def _set_asyncio_loop(self, loop: Any) -> None:
        self.asyncio_loop = loop

    def _push_locals(self) -> None:
        self._locals.append(dict(self._locals[-1]))

    def _pop_locals(self) -> None:
        self._locals.pop()

    def extend_locals(self, values: dict[str, Any]) -> None:
        self._locals[-1].update(values)

    def get_locals_as_dict(self) -> dict[str, Any]:
        return self._locals[-1]

    def register_event_handler(self, event_handler: Any, append: bool = False) -> None:
        if append:
            self._event_handlers.append(event_handler)
        else:
            self._event_handlers.appendleft(event_handler)

    def unregister_event_handler(self, event_handler: Any) -> None:
        self._event_handlers.remove(event_handler)

    def emit_event_sync(self, event: Any) -> None:
        raise NotImplementedError

    async def emit_event(self, event: Any) -> None:
        raise NotImplementedError
