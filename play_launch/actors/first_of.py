"""Waiting for the first of several things."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import anyio

if TYPE_CHECKING:
    from collections.abc import Coroutine


async def first_of(*coroutines: Coroutine[Any, Any, object]) -> None:
    """Wait until one of them has ended and cancel the others; an error is raised.

    Everything has ended when this returns or raises, also when it is cancelled.
    """

    async def one(coroutine: Coroutine[Any, Any, object]) -> None:
        await coroutine
        group.cancel_scope.cancel()

    async with anyio.create_task_group() as group:
        for coroutine in coroutines:
            group.start_soon(one, coroutine)
