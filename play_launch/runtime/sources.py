"""Tasks of an actor: they wait, and post inputs."""

from __future__ import annotations

from contextlib import suppress
from contextvars import Context, copy_context
from importlib import import_module
from typing import TYPE_CHECKING, Any

import anyio

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Coroutine

    from anyio.abc import TaskGroup


class Source:
    """Handle of one task."""

    def __init__(self) -> None:
        self.runs = True
        """Whether the task has not ended."""
        self.is_cancelled = False
        self._scope: anyio.CancelScope | None = None

    def cancel(self) -> None:
        """Cancel the task; one that has not begun yet never does."""
        self.is_cancelled = True
        if self._scope is not None:
            self._scope.cancel()

    async def run(self, work: Callable[[], Awaitable[None]]) -> None:
        """Run ``work`` until it ends or is cancelled."""
        with anyio.CancelScope() as self._scope:
            if not self.is_cancelled:
                await work()


class Sources:
    """Belongs to the thread of the event loop."""

    def __init__(self, on_error: Callable[[Exception], None]) -> None:
        """``on_error`` gets each exception of a task, and must not raise."""
        self._on_error = on_error
        self._tasks: TaskGroup | None = None
        self._context = Context()

    @property
    def tasks(self) -> TaskGroup:
        """Task group in which they run."""
        assert self._tasks is not None
        return self._tasks

    def run_in(self, tasks: TaskGroup) -> None:
        """Run them in ``tasks`` from now on."""
        self._tasks = tasks
        self._context = copy_context()
        # Where sniffio is installed, anyio gets the event loop from it; outside of a task, as in a
        # callback of the loop, sniffio reads this variable only.
        with suppress(ModuleNotFoundError):
            sniffio = import_module("sniffio")
            self._context.run(sniffio.current_async_library_cvar.set, "asyncio")

    def begin(self, work: Callable[[], Awaitable[None]]) -> Source:
        """Begin a task; an exception in it goes to ``on_error``."""
        assert self._tasks is not None
        source = Source()
        self._context.copy().run(self._tasks.start_soon, self._run, source, work)
        return source

    async def _run(self, source: Source, work: Callable[[], Awaitable[None]]) -> None:
        try:
            await source.run(work)
        except Exception as error:  # noqa: BLE001 - the other units go on
            self._on_error(error)
        finally:
            source.runs = False


def failure_reason(error: Exception) -> str:
    """Name an unexpected exception in one line; of a group, the first one."""
    while isinstance(error, ExceptionGroup):
        error = error.exceptions[0]
    text = " ".join(f"{type(error).__name__}: {error}".split())
    return f"internal error (its call stack is in the recording): {text}"


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
