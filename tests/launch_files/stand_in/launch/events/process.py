"""Events of processes."""

from __future__ import annotations

from typing import Any

from . import Event


class _ProcessEvent(Event):
    def __init__(self, *, action: Any, pid: int, **details: Any) -> None:
        self.action = action
        self.pid = pid
        self.details = details


class ProcessStarted(_ProcessEvent):
    pass


class ProcessExited(_ProcessEvent):
    def __init__(self, *, returncode: int, **details: Any) -> None:
        super().__init__(**details)
        self.returncode = returncode


class _TargetedEvent(Event):
    def __init__(self, *, process_matcher: Any, **details: Any) -> None:
        self.process_matcher = process_matcher
        self.details = details


class ShutdownProcess(_TargetedEvent):
    pass


class SignalProcess(_TargetedEvent):
    pass
