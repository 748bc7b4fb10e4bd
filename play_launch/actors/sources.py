"""The tasks of a member: they do nothing but hand over what happens."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable

    from anyio.abc import TaskGroup


class Source:
    """One of them."""

    def __init__(self) -> None:
        self.runs = True
        """Whether it is to hand over anything yet."""


class Sources:
    """Belongs to the thread of the event loop."""

    def __init__(self, on_error: Callable[[Exception], None]) -> None:
        """Take what gets whatever one of them raises, and must not raise itself."""
        self._on_error = on_error
        self._tasks: TaskGroup | None = None

    def run_in(self, tasks: TaskGroup) -> None:
        """Run them in ``tasks`` from now on."""
        self._tasks = tasks

    def begin(self, work: Callable[[], Awaitable[None]]) -> Source:
        """Begin one; what it raises is the member's failure."""
        assert self._tasks is not None
        source = Source()
        self._tasks.start_soon(self._run, source, work)
        return source

    async def _run(self, source: Source, work: Callable[[], Awaitable[None]]) -> None:
        try:
            await work()
        except Exception as error:  # noqa: BLE001 - others are not to pay for it
            self._on_error(error)
        finally:
            source.runs = False
