"""Waits until what runs is as somebody wants it."""

from __future__ import annotations

import asyncio
import contextlib
from typing import TYPE_CHECKING

from play_launch.supervisor.events import ManagedNodeChanged, StateEvent, Withdrawn

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Iterator, Sequence

    from play_launch.control.feed import Feed
    from play_launch.control.outcome import Verdict
    from play_launch.control.targets import Target
    from play_launch.supervisor.events import RunEvent


@contextlib.contextmanager
def changes_of_state(feed: Feed) -> Iterator[asyncio.Event]:
    """Set an event whenever a state changes, while the block runs."""
    changed = asyncio.Event()

    def see(event: RunEvent) -> None:
        if isinstance(event, StateEvent | ManagedNodeChanged | Withdrawn):
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
        _judge_missing(targets, judge, verdicts)
        if len(verdicts) == len(targets):
            return
        await changed.wait()
        changed.clear()


def _judge_missing(
    targets: Sequence[Target],
    judge: Callable[[Target], Verdict | None],
    verdicts: dict[Target, Verdict],
) -> None:
    for target in targets:
        if target not in verdicts and (verdict := judge(target)) is not None:
            verdicts[target] = verdict


async def until_all_are(
    choose: Callable[[], Sequence[Target]],
    judge: Callable[[Target], Verdict | None],
    *,
    targets: list[Target],
    verdicts: dict[Target, Verdict],
    changed: asyncio.Event,
    until_applied: Callable[[], Awaitable[None]],
) -> None:
    """Wait until all are done at the same moment, or one never will be.

    Args:
        choose: Gives what is waited for by now.
        judge: Gives the verdict; None: not yet.
        targets: Gets what is waited for.
        verdicts: Gets the verdicts.
        changed: Is set when it is worth judging again.
        until_applied: Waits for a configuration that is being applied: until then members are
            stopped that will be replaced or removed.
    """
    while True:
        await until_applied()
        changed.clear()
        targets[:] = choose()
        for left in verdicts.keys() - {*targets}:
            del verdicts[left]
        _judge_missing(targets, judge, verdicts)
        if len(verdicts) == len(targets):
            verdicts.clear()  # what was done earlier may not be any more
            _judge_missing(targets, judge, verdicts)
        is_failed = any(not each.is_done for each in verdicts.values())
        if is_failed or len(verdicts) == len(targets):
            return
        await changed.wait()
