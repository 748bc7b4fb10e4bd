"""Waits until what runs is as somebody wants it."""

from __future__ import annotations

import asyncio
import contextlib
from typing import TYPE_CHECKING

from play_launch.core.events import ManagedNodeChanged, StateEvent

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from play_launch.control.feed import Feed
    from play_launch.control.outcome import Verdict
    from play_launch.control.targets import Target
    from play_launch.core.events import RunEvent


@contextlib.contextmanager
def changes_of_state(feed: Feed) -> Iterator[asyncio.Event]:
    """Set an event whenever a state changes, while the block runs."""
    changed = asyncio.Event()

    def see(event: RunEvent) -> None:
        if isinstance(event, StateEvent | ManagedNodeChanged):
            changed.set()

    with feed.followed_by(see):
        yield changed


async def until_judged(
    targets: Sequence[Target],
    judge: Callable[[Target], Verdict | None],
    verdicts: dict[Target, Verdict],
    changed: asyncio.Event,
) -> None:
    """Note what becomes of each, until that is known of all; cancel it when it takes too long.

    Args:
        targets: What is judged.
        judge: Gives the verdict; None: not yet.
        verdicts: Gets the verdicts.
        changed: Is set when it is worth judging again.
    """
    while True:
        for target in targets:
            if target not in verdicts and (verdict := judge(target)) is not None:
                verdicts[target] = verdict
        if len(verdicts) == len(targets):
            return
        await changed.wait()
        changed.clear()
