"""Handlers of events: for one action, or for all of a kind."""

from __future__ import annotations

from typing import Any

from .events.process import ProcessExited, ProcessStarted

__all__ = [
    "EventHandler",
    "OnExecutionComplete",
    "OnProcessExit",
    "OnProcessIO",
    "OnProcessStart",
    "OnShutdown",
]


class OnActionEventBase:
    def __init__(self, kind: type, target: Any, on_event: Any) -> None:
        self._kind = kind
        self._target = target
        self._actions = None if callable(on_event) else on_event
        if callable(on_event):
            self._OnActionEventBase__on_event = on_event

    def matches(self, event: Any) -> bool:
        target = getattr(event, "action", None)
        return isinstance(event, self._kind) and self._target in {None, target}

    def handle(self, event: Any, context: Any) -> Any:
        context.extend_locals({"event": event})
        if self._actions is None:
            return self._OnActionEventBase__on_event(event, context)
        return self._actions


class OnProcessExit(OnActionEventBase):
    def __init__(self, *, target_action: Any = None, on_exit: Any) -> None:
        super().__init__(ProcessExited, target_action, on_exit)


class OnProcessStart(OnActionEventBase):
    def __init__(self, *, target_action: Any = None, on_start: Any) -> None:
        super().__init__(ProcessStarted, target_action, on_start)


class OnExecutionComplete:
    def __init__(self, **named: Any) -> None:
        self.named = named

    def handle(self, event: Any, context: Any) -> Any:
        raise NotImplementedError


class EventHandler(OnExecutionComplete):
    pass


class OnProcessIO(OnExecutionComplete):
    pass


class OnShutdown(OnExecutionComplete):
    pass
