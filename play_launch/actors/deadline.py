"""Waiting for events and points in time."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Coroutine


async def happens_before(event: asyncio.Event, when: float | None) -> bool:
    """Wait for an event; False when the loop's clock comes to ``when`` first (None: never)."""
    try:
        async with asyncio.timeout_at(when):
            await event.wait()
    except TimeoutError:
        return False
    return True


async def acquired_before(event: asyncio.Event, semaphore: asyncio.Semaphore) -> bool:
    """Wait for a place; False, without one, when the event comes first."""
    waiting = asyncio.ensure_future(semaphore.acquire())
    try:
        await first_of(_wait(waiting), event.wait())
    except BaseException:
        _give_back(waiting, semaphore)
        raise
    if event.is_set():
        _give_back(waiting, semaphore)
        return False
    return True


async def _wait(future: asyncio.Future[Any]) -> None:
    await future


def _give_back(waiting: asyncio.Future[Any], semaphore: asyncio.Semaphore) -> None:
    if waiting.done() and not waiting.cancelled():
        semaphore.release()
    waiting.cancel()


async def first_of(*coroutines: Coroutine[Any, Any, object]) -> None:
    """Wait until one of them has ended and cancel the others; an error is raised.

    Everything has ended when this returns or raises, also when it is cancelled.
    """
    async with asyncio.TaskGroup() as group:
        tasks = [group.create_task(coroutine) for coroutine in coroutines]
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        for task in tasks:
            task.cancel()
