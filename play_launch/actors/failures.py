"""What an unexpected exception in the supervisor's own code costs: one member, not the system."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable

    from play_launch.actors.ports import ManagedProcess

_log = logging.getLogger(__name__)


def failure_reason(error: Exception) -> str:
    """Name an unexpected exception in one line; of a group, the first one."""
    while isinstance(error, ExceptionGroup):
        error = error.exceptions[0]
    text = " ".join(f"{type(error).__name__}: {error}".split())
    return f"internal error (its call stack is in the recording): {text}"


async def stop_in_order(
    process: ManagedProcess, *, ask: Callable[[], bool] | None, hurry: asyncio.Event
) -> None:
    """Stop the process of a member that failed: as gently as it allows, and kill it in the end.

    It is killed at once when this is cancelled, or when stopping fails as well.
    """
    try:
        await process.stop(ask=ask, hurry=hurry)
    except Exception:  # noqa: BLE001 - it is logged, and the stop goes on
        _log.exception("pid %d could not be stopped in order and is killed", process.pid)
        process.kill()
    except BaseException:
        process.kill()
        raise
