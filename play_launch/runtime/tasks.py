"""Tasks of a system: they wait, and post inputs."""

from __future__ import annotations

from contextlib import suppress
from contextvars import Context, copy_context
from importlib import import_module
from typing import TYPE_CHECKING

import anyio

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable

    from anyio.abc import TaskGroup


class Tasks:
    """Belongs to the thread of the event loop."""

    def __init__(self) -> None:
        self._group: TaskGroup | None = None
        self._context = Context()

    def run_in(self, group: TaskGroup) -> None:
        """Run them in ``group`` from now on."""
        self._group = group
        self._context = copy_context()
        # Where sniffio is installed, anyio gets the event loop from it; outside of a task, as in a
        # callback of the loop, sniffio reads this variable only.
        with suppress(ModuleNotFoundError):
            sniffio = import_module("sniffio")
            self._context.run(sniffio.current_async_library_cvar.set, "asyncio")

    def scope(self) -> anyio.CancelScope:
        """Make a scope that a task enters later."""
        return self._context.copy().run(anyio.CancelScope)

    def begin(
        self, work: Callable[[], Awaitable[None]], on_error: Callable[[Exception], None]
    ) -> anyio.CancelScope:
        """Begin a task; cancelled before that, it never does. An exception is no other task's."""
        assert self._group is not None
        scope = self.scope()
        self._context.copy().run(self._group.start_soon, _run, scope, work, on_error)
        return scope


async def _run(
    scope: anyio.CancelScope,
    work: Callable[[], Awaitable[None]],
    on_error: Callable[[Exception], None],
) -> None:
    try:
        with scope:
            if not scope.cancel_called:
                await work()
    except Exception as error:  # noqa: BLE001 - the other units go on
        on_error(error)
