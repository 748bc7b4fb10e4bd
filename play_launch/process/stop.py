"""The one way in which a process is stopped: ask, SIGINT, SIGTERM, SIGKILL.

`plan` decides and is pure; `stop` carries it out.
"""

from __future__ import annotations

import signal
from enum import IntEnum
from typing import TYPE_CHECKING

import anyio
from msgspec import Struct

from play_launch.config.model import StopLimits
from play_launch.process.descendants import signal_each, wait_all_ended

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable

    from play_launch.process.child import Child
    from play_launch.process.exit import Exit
    from play_launch.process.identity import ProcessStat


class StopLevel(IntEnum):
    """How far one had to go; the levels after `ASK` are names of signals."""

    NONE = 0
    """It had exited before."""
    ASK = 1
    SIGINT = 2
    SIGTERM = 3
    SIGKILL = 4


class StopPolicy(StopLimits, frozen=True, kw_only=True):
    """Seconds to wait at each level before the next; 0 leaves a level out.

    `hurried` is what is left of the present level, and all the later ones get at most, once
    the stop is hurried. `sigkill` bounds the wait for the kernel: a process in an
    uninterruptible system call does not die.
    """

    sigkill: float = 5.0
    hurried: float = 0.3


class StopStep(Struct, frozen=True):
    """One level and its limit in seconds."""

    level: StopLevel
    limit: float


class StopOutcome(Struct, frozen=True):
    """How a stop went.

    Attributes:
        level: What the process itself needed.
        exit: How it ended; None when even SIGKILL did not end it in time.
        stragglers: How many others of its session had to be killed with SIGKILL.
    """

    level: StopLevel
    exit: Exit | None
    stragglers: int = 0


def plan(policy: StopPolicy, *, can_ask: bool) -> tuple[StopStep, ...]:
    """The levels to go through; SIGKILL is always the last."""
    steps = [
        StopStep(StopLevel[name.upper()], getattr(policy, name))
        for name in (*StopLimits.__struct_fields__, "sigkill")
        if can_ask or name != "ask"
    ]
    return tuple(step for step in steps if step.limit > 0 or step.level is StopLevel.SIGKILL)


async def stop(
    child: Child,
    policy: StopPolicy,
    *,
    ask: Callable[[], bool] | None = None,
    hurry: asyncio.Event | None = None,
) -> StopOutcome:
    """Stop a child and everything in its session, as gently as it allows.

    Signals go to the whole session. What has left it gets SIGTERM when the child has ended: the
    child may be about to end it itself. The processes that the child leaves behind get the time
    that the present level has left, then the next levels. Afterwards nothing of it runs and it was
    waited for (as after `Child.gone`). When this is cancelled, whatever the child leaves is
    killed at once as soon as the child itself ends.

    Args:
        child: The child to stop; it may have exited already.
        policy: The limits.
        ask: Asks it to stop, in its own language; False when it could not be asked.
        hurry: Set to skip to the next signal.
    """
    level = StopLevel.NONE
    stragglers = 0
    with child.holding_session():
        for step in plan(policy, can_ask=ask is not None):
            others = await child.members()
            if not child.is_running and not others:
                break
            if step.level is StopLevel.ASK:
                if not child.is_running or ask is None or not ask():
                    continue
            else:
                _signal_session(child, others, signal.Signals[step.level.name])
            if child.is_running:
                level = step.level
            elif step.level is StopLevel.SIGKILL:
                stragglers = len(others)
            await _session_ended(child, policy, step, hurry)
    if child.is_running:
        return StopOutcome(level, None, stragglers)
    return StopOutcome(level, await child.gone(), stragglers)


def _signal_session(child: Child, members: list[ProcessStat], number: signal.Signals) -> None:
    if number is signal.SIGKILL and child.kill_all():
        return
    is_over = number is signal.SIGKILL or not child.is_running
    reached = [each for each in members if is_over or each.session == child.pid]
    # A process that is stopped (SIGSTOP, a debugger) sees SIGTERM only when continued.
    for each in (number, signal.SIGCONT) if number is signal.SIGTERM else (number,):
        # A shell with job control puts its jobs into groups of their own. No process gets it
        # twice: to many programs a second SIGINT means something else.
        got_it = child.pid if child.signal_group(each) else None
        signal_each((member.identity for member in reached if member.group != got_it), each)


def _end_strays(child: Child, members: list[ProcessStat]) -> None:
    """Ask what has left the session to end."""
    strays = [each.identity for each in members if child.pid not in {each.session, each.group}]
    for number in (signal.SIGTERM, signal.SIGCONT):
        signal_each(strays, number)


async def shorten(limit: anyio.CancelScope, hurry: asyncio.Event, seconds: float) -> None:
    """Leave a wait so many seconds at most once it is hurried."""
    await hurry.wait()
    limit.deadline = min(limit.deadline, anyio.current_time() + seconds)


async def _session_ended(
    child: Child, policy: StopPolicy, step: StopStep, hurry: asyncio.Event | None
) -> None:
    """Wait for the end of the whole session, as long as the step allows."""
    with anyio.move_on_after(step.limit) as limit:
        async with anyio.create_task_group() as tasks:
            # The kernel gets its time: afterwards nothing would check any more.
            if hurry is not None and step.level is not StopLevel.SIGKILL:
                tasks.start_soon(shorten, limit, hurry, policy.hurried)
            ends_now = child.is_running
            await child.wait()
            rest = await child.members()
            if ends_now:
                _end_strays(child, rest)
            while rest:
                await wait_all_ended([member.identity for member in rest])
                rest = await child.members()
            tasks.cancel_scope.cancel()
