"""Programs beside a system: started again within limits; their end changes nothing else."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import random
import signal
from typing import TYPE_CHECKING, Final

from play_launch.config.model import RestartLimits
from play_launch.process.child import spawn
from play_launch.process.guard import SessionGuard, SpawnError
from play_launch.supervisor.outcome import RestartHistory, decide

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Mapping, Sequence
    from pathlib import Path

    from play_launch.process.child import Child
    from play_launch.process.lines import Line
    from play_launch.supervisor.events import Stream

_log = logging.getLogger(__name__)
_LIMITS: Final = RestartLimits(max_restarts=3, within=60.0, initial=0.5, maximum=8.0)
_LONGEST_END: Final = 1.0
"""Seconds from SIGTERM to SIGKILL."""


async def keep_running(loss: str, live: Callable[[], Awaitable[str]]) -> None:
    """Call ``live``, which returns the reason of its end, again and again, until that is too often.

    Args:
        loss: What is not there meanwhile, for the log: "topics are not recorded".
        live: Runs the program once.
    """
    loop = asyncio.get_running_loop()
    history = RestartHistory()
    while True:
        began = loop.time()
        reason = await live()
        now = loop.time()
        jitter = random.random()  # noqa: S311 - spreads restarts
        history, decision = decide(history, _LIMITS, now=now, lived=now - began, jitter=jitter)
        if isinstance(decision, str):
            _log.warning("%s any more: %s; %s", loss, reason, decision)
            return
        _log.warning("%s for %.1f s: %s; it is started again", loss, decision, reason)
        await asyncio.sleep(decision)


async def run_companion(
    loss: str,
    argv: Sequence[str],
    env: Mapping[str, str],
    *,
    guard_program: Path,
    on_output: Callable[[int, Stream, Sequence[Line]], None],
) -> None:
    """Keep a program running until cancelled; then it is ended, at last by SIGKILL.

    ``on_output`` gets its pid, the stream and lines. Returns when it has ended too often. Raises
    OSError where no guard can be started.
    """
    guard = await asyncio.to_thread(SessionGuard.start, guard_program)
    child: Child | None = None

    async def live() -> str:
        nonlocal child

        def passed_on(stream: Stream, lines: Sequence[Line]) -> None:
            on_output(started.pid, stream, lines)

        try:
            started = child = await spawn(argv, env=env, guard=guard, on_output=passed_on)
        except SpawnError as error:
            return str(error)
        return f"{argv[1]} {await child.gone()}"

    try:
        await keep_running(loss, live)
    finally:
        if child is not None:
            child.send_signal(signal.SIGTERM)
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(_LONGEST_END):
                    await child.wait()
            child.kill()
            await child.gone()
        await guard.end()
