"""Descendants of a child outside of its session: daemons, and commands under setsid(1).

As long as its parents live, it is below the child. When they have ended, it is a child of the
guard, and whose it was is in a variable that the child got, and that its children inherit.
A process that has left its parents and cleared its environment is not attributed: the guard ends it
with the session.
"""

from __future__ import annotations

import asyncio
import itertools
import logging
import time
from collections import defaultdict
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Final

from play_launch.process.descendants import in_a_thread
from play_launch.process.identity import parse_stat

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Sequence

    from play_launch.process.guard import SessionGuard
    from play_launch.process.identity import ProcessIdentity, ProcessStat

_log = logging.getLogger(__name__)

_LONGEST_READ: Final = 1.0
"""Seconds until a process counts as one that cannot be looked into."""

_LONGEST_EXECUTION: Final = 0.5
"""Seconds that a program may take to be mapped."""
_PAUSE: Final = 0.001
_LOOKS_AT_NONE: Final = 5
"""An environment has no bytes for a moment while it is made; after so many reads, it has none."""
_ENVIRONMENT: Final = slice(47, 49)
"""Begin and end of it, among what follows the command in ``/proc/<pid>/stat``."""

MEMBER_VARIABLE: Final = "PLAY_LAUNCH_MEMBER"
"""Names the child that a process came of, and the supervisor of it."""


def mark_for(supervisor: object, name: str) -> str:
    """Make that variable's value of the supervisor's pid, or what stands for it, and a name."""
    return f"{supervisor}:{name}"


class Kin:
    """Finds the descendants of one child; belongs to the loop's thread."""

    def __init__(self, leader: ProcessIdentity, guard: SessionGuard, mark: str) -> None:
        """Find descendants of the child ``leader``, which has ``mark`` in its environment."""
        self._leader = leader
        self._guard = guard
        self._mark = mark
        self._seen: set[ProcessIdentity] = set()

    async def among(self, table: Collection[ProcessStat]) -> list[ProcessStat]:
        """Return what of the table came of it, in whatever session, without the child itself.

        What was found once is found again after its parents have ended.
        """
        living = [each for each in table if each.is_alive]
        roots = {each.pid for each in living if each.identity in self._seen}
        roots |= {each.pid for each in table if each.identity == self._leader}
        roots |= {*await self._orphans(living)}
        found = [each for each in below(living, roots) if each.identity != self._leader]
        self._seen = {each.identity for each in found}
        return found

    async def _orphans(self, living: Iterable[ProcessStat]) -> list[int]:
        orphans = [each for each in living if self._guard.has_inherited(each)]
        if not self._mark or not orphans:
            return []
        marks = await _marks_of(orphans)
        return [each.pid for each in orphans if marks.get(each.identity) == self._mark]


_unreadable: set[ProcessIdentity] = set()
"""Processes whose environment could not be read in time."""


async def _marks_of(processes: Sequence[ProcessStat]) -> dict[ProcessIdentity, str]:
    """Read marks; those that cannot be read are left out.

    A process that waits for a disk may block readers of its memory without limit. So it is
    read in a thread.
    """
    found: dict[ProcessIdentity, str] = {}
    todo = [each for each in processes if each.identity not in _unreadable]
    while todo:
        if await _read_in_time(todo, found):
            break
        stuck = next(each for each in todo if each.identity not in found)
        _unreadable.add(stuck.identity)
        text = "%s (pid %d) ends with the session, as its environment cannot be read"
        _log.warning(text, stuck.command, stuck.pid)
        todo = todo[todo.index(stuck) + 1 :]
    return found


async def _read_in_time(
    processes: Sequence[ProcessStat], found: dict[ProcessIdentity, str]
) -> bool:
    def read() -> None:
        for each in processes:
            found[each.identity] = mark_of(each.pid)

    with suppress(TimeoutError):
        await asyncio.wait_for(in_a_thread(read), _LONGEST_READ)
    return all(each.identity in found for each in processes)


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
    deadline = time.monotonic() + _LONGEST_EXECUTION
    name = f"{MEMBER_VARIABLE}=".encode()
    looks = itertools.count(1)
    try:
        while True:
            text = Path(f"/proc/{pid}/environ").read_bytes()
            for each in text.split(b"\0"):
                if each.startswith(name):
                    return each.removeprefix(name).decode(errors="replace")
            is_certain = bool(text) or next(looks) >= _LOOKS_AT_NONE
            if is_certain and not _is_being_executed(pid, len(text)):
                return ""
            if time.monotonic() > deadline:
                return ""
            time.sleep(_PAUSE)
    except OSError:  # it has ended, or is another user's by now
        return ""


def _is_being_executed(pid: int, size: int) -> bool:
    """Whether a process is getting its environment, of which so many bytes were read.

    execve(2) begins with none, and what is read while it goes on may be cut.
    """
    stat = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace")
    begin, end = map(int, stat.rpartition(")")[2].split()[_ENVIRONMENT])
    return parse_stat(stat).is_alive and (end == 0 or end - begin != size)
