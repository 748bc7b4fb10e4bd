"""What came of a child and has left its session: daemons, and what setsid(1) was put before.

As long as its parents live, it is below the child. When they have ended, it is a child of the
guard, and whose it was is in a variable that the child got, and that its children inherit.
A process that has left its parents and cleared its environment belongs to nobody: the guard ends it
with the session.
"""

from __future__ import annotations

import asyncio
from collections import defaultdict
from pathlib import Path
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable

    from play_launch.process.guard import Parent
    from play_launch.process.identity import ProcessIdentity, ProcessStat

MEMBER_VARIABLE: Final = "PLAY_LAUNCH_MEMBER"
"""Names the child that a process came of, and the supervisor of it."""


def mark_for(supervisor: object, name: str) -> str:
    """Make that variable's value of the supervisor's pid, or what stands for it, and a name."""
    return f"{supervisor}:{name}"


class Kin:
    """Finds what came of one child; belongs to the loop's thread."""

    def __init__(self, leader: int, parent: Parent, mark: str) -> None:
        """Look for what came of the child ``leader``, which has ``mark`` in its environment."""
        self._leader = leader
        self._parent = parent
        self._mark = mark
        self._seen: set[ProcessIdentity] = set()

    async def among(self, table: Iterable[ProcessStat]) -> list[ProcessStat]:
        """Return what of the table came of it, in whatever session, without the child itself.

        What was found once is found again after its parents have ended.
        """
        living = [each for each in table if each.is_alive]
        roots = {each.pid for each in living if each.identity in self._seen}
        roots |= {self._leader, *await self._orphans(living)}
        found = [each for each in below(living, roots) if each.pid != self._leader]
        self._seen = {each.identity for each in found}
        return found

    async def _orphans(self, living: Iterable[ProcessStat]) -> list[int]:
        orphans = [each for each in living if self._parent.has_inherited(each)]
        if not self._mark or not orphans:
            return []
        # A process that waits for a disk may hold up whoever reads its memory.
        marks = await asyncio.to_thread(lambda: [mark_of(each.pid) for each in orphans])
        return [each.pid for each, mark in zip(orphans, marks, strict=True) if mark == self._mark]


def below(table: Collection[ProcessStat], roots: Collection[int]) -> list[ProcessStat]:
    """Find processes and all that descends from them."""
    children = defaultdict(list)
    for each in table:
        children[each.parent].append(each)
    found = {each.pid: each for each in table if each.pid in roots}
    todo = list(roots)
    while todo:
        for each in children[todo.pop()]:
            if each.pid not in found:
                found[each.pid] = each
                todo.append(each.pid)
    return list(found.values())


def mark_of(pid: int) -> str:
    """Read which child a process came of; empty where that cannot be known."""
    try:
        variables = Path(f"/proc/{pid}/environ").read_bytes().split(b"\0")
    except OSError:  # it has ended, or is another user's by now
        return ""
    name = f"{MEMBER_VARIABLE}=".encode()
    marks = (each.removeprefix(name) for each in variables if each.startswith(name))
    return next(marks, b"").decode(errors="replace")
