"""Operations with which the coordinator of several machines accompanies the part of one.

It reports conditions that are met elsewhere, follows those that others wait for, measures the
offset of the clocks, and holds the lease without which a part with `stop_after` stops itself.
"""

from __future__ import annotations

import asyncio
import logging
import time
from typing import TYPE_CHECKING, Annotated

from msgspec import Meta, Struct

from play_launch.config.dependency import Condition  # noqa: TC001 - msgspec reads annotations
from play_launch.config.machines import AWAITED_ELSEWHERE
from play_launch.control.messages import Seconds  # noqa: TC001 - msgspec reads annotations
from play_launch.supervisor.conditions import condition_state
from play_launch.supervisor.view import exit_code

if TYPE_CHECKING:
    from collections.abc import Callable

    from play_launch.control.messages import Caller
    from play_launch.runtime.system import System
    from play_launch.supervisor.events import RunEvent
    from play_launch.supervisor.view import SystemView

Met = tuple[str, str, str]
"""Condition, unit, and subject: the pattern of a line of output, else empty."""
_log = logging.getLogger(__name__)


class MeetRequest(Struct, frozen=True):
    """Arguments of ``meet``."""

    met: Annotated[tuple[tuple[Condition, str, str], ...], Meta(max_length=10_000)]
    """all conditions that are met on other machines: condition, unit, pattern"""


class Lease(Struct, frozen=True):
    """Arguments of ``lease``."""

    seconds: Seconds
    """time after which the session stops itself, unless a lease follows"""


class Coordinated:
    """What a coordinator operates in the session of a part."""

    def __init__(self, system: System, recording_clock: Callable[[], int]) -> None:
        """Take the system; ``recording_clock`` gives the log time of its recording, in ns."""
        self._recording_clock = recording_clock
        self._system = system
        self._changed = asyncio.Event()
        self._lease: asyncio.TimerHandle | None = None

    def publish(self, event: RunEvent, before: SystemView, after: SystemView) -> None:  # noqa: ARG002 - a sink
        self._changed.set()

    async def clock(self, _request: object, _caller: Caller) -> object:
        return {"stamp_ns": time.time_ns(), "recording_ns": self._recording_clock()}

    async def meet(self, request: MeetRequest, _caller: Caller) -> object:
        self._system.outside.tell(frozenset(request.met))
        return {"met": len(request.met)}

    async def conditions(self, _request: object, caller: Caller) -> object:
        """Send what coordinates machines at each change, until the connection ends.

        It is the conditions that are met of those that others wait for, and the exit code that the
        session would have.
        """
        seen: SystemView | None = None
        sent: dict[str, object] = {}
        while True:
            self._changed.clear()
            now = sent | {"met": self._met()}
            if (view := self._system.publisher.view) is not seen:
                seen = view
                now["exit_code"] = exit_code(self._system.view_before_stop, view, None)
            for name, value in now.items():
                if name not in sent or sent[name] != value:
                    await caller.send(name, value)
            sent = now
            await self._changed.wait()

    async def lease(self, request: Lease, _caller: Caller) -> object:
        if self._lease is not None:
            self._lease.cancel()
        self._lease = asyncio.get_running_loop().call_later(
            request.seconds,
            self._end,
            f"the coordinator was not heard of for {request.seconds:g} s",
        )
        return {"seconds": request.seconds}

    async def end(self, _request: object, caller: Caller) -> object:
        self._end(f"the coordinator (pid {caller.pid} here) stops all machines")
        return {"pending": list(self._system.pending)}

    def _end(self, reason: str) -> None:
        _log.warning("%s: shutting down", reason)
        self._system.stop_requests.request(reason=reason)

    def _met(self) -> list[Met]:
        world = self._system.world
        rule = world.config.start_rules.get(AWAITED_ELSEWHERE)
        if rule is None:
            return []
        return [
            (str(each.condition), each.unit, each.subject)
            for each in rule.dependencies
            if condition_state(world, each) == ""
        ]
