"""The processes of a session: what a child of ours has started and not left behind.

Every child leads a session of its own, so that whatever it forks can be found after its death.
What calls setsid(2) itself is found by `play_launch.process.kin`.
"""

from __future__ import annotations

import asyncio
import errno
import os
import threading
from contextlib import ExitStack, suppress
from functools import partial
from typing import TYPE_CHECKING, Final, Generic, TypeVar
from weakref import WeakKeyDictionary

import anyio

from play_launch.process.identity import (
    NoSuchProcessError,
    ProcessHandle,
    ProcessIdentity,
    ProcessStat,
    list_processes,
    read_stat,
)

if TYPE_CHECKING:
    import signal
    from collections.abc import Callable, Coroutine, Iterable, Sequence

    from play_launch.process.cgroups.group import Group
    from play_launch.process.kin import Kin


_Result = TypeVar("_Result")
_TICKS: Final = os.sysconf("SC_CLK_TCK")


class Shared(Generic[_Result]):
    """Does a piece of work for many askers at once.

    When a system stops, a hundred containers ask within a few milliseconds. Everyone gets a result
    of work that began after the question, and all that wait for the same one share it.
    """

    def __init__(self, work: Callable[[], Coroutine[object, object, _Result]]) -> None:
        """Take what does it, once for each batch of askers."""
        self._work = work
        self._running: asyncio.Task[_Result] | None = None
        self._next: asyncio.Task[_Result] | None = None

    async def result(self) -> _Result:
        """Wait for a result of work that begins from now on."""
        if self._next is None:
            self._next = asyncio.create_task(self._do(self._running))
        return await asyncio.shield(self._next)

    async def _do(self, before: asyncio.Task[_Result] | None) -> _Result:
        if before is not None:
            await asyncio.wait({before})
        self._running, self._next = self._next, None
        return await self._work()


def in_a_thread(work: Callable[[], _Result]) -> asyncio.Future[_Result]:
    """Do work that the kernel may hold up without limit: a mount or a process does not answer.

    In a daemon thread: one of an executor would prevent the exit of the program. Raises OSError
    (EAGAIN) if there can be no more threads.
    """
    loop = asyncio.get_running_loop()
    done: asyncio.Future[_Result] = loop.create_future()

    def run() -> None:
        try:
            settle = partial(done.set_result, work())
        except Exception as error:  # noqa: BLE001 - it is raised where it is awaited
            settle = partial(done.set_exception, error)
        with suppress(RuntimeError):  # the loop is closed
            loop.call_soon_threadsafe(lambda: None if done.done() else settle())

    try:
        threading.Thread(target=run, daemon=True).start()
    except RuntimeError as error:
        raise OSError(errno.EAGAIN, "no thread can be started") from error
    return done


async def first_of(*coroutines: Coroutine[object, object, object]) -> None:
    """Wait until one of them has ended and cancel the others; raises what that raises."""
    errors: list[Exception] = []

    async def one(coroutine: Coroutine[object, object, object]) -> None:
        try:
            await coroutine
        except Exception as error:  # noqa: BLE001 - raised below, outside of the group
            if not group.cancel_scope.cancel_called:
                errors.append(error)
        group.cancel_scope.cancel()

    async with anyio.create_task_group() as group:
        for coroutine in coroutines:
            group.start_soon(one, coroutine)
    if errors:
        raise errors[0]


async def _scan() -> list[ProcessStat]:
    return await asyncio.to_thread(list_processes)


_scans: WeakKeyDictionary[asyncio.AbstractEventLoop, Shared[list[ProcessStat]]]
_scans = WeakKeyDictionary()


async def session_members(
    leader: ProcessIdentity, kin: Kin, *, until: float | None = None
) -> list[ProcessStat]:
    """Find what lives in the session or the process group of `leader`, and what has left them.

    Without the leader. Until that is waited for, its number cannot mean another session. When it
    was waited for by another than us, `until` is when we noticed, in seconds after boot: what
    started later may be in another session of that number.
    """
    scans = _scans.setdefault(asyncio.get_running_loop(), Shared(_scan))
    table = await scans.result()
    is_taken = any(stat.pid == leader.pid and stat.identity != leader for stat in table)
    members = [
        stat
        for stat in table
        if leader.pid in (stat.session, stat.group)
        and stat.pid != leader.pid
        and stat.is_alive
        and not is_taken
        and (until is None or stat.start_time <= until * _TICKS)
    ]
    known = {stat.pid for stat in members}
    return [*members, *(stat for stat in await kin.among(table) if stat.pid not in known)]


def group_members(group: Group, leader: int) -> list[ProcessStat]:
    """Find what lives in a control group, besides the leader: processes do not leave it."""
    members = []
    for pid in group.processes():
        try:
            stat = read_stat(pid)
        except NoSuchProcessError:
            continue
        if pid != leader and stat.is_alive:
            members.append(stat)
    return members


def signal_each(
    processes: Iterable[ProcessIdentity], number: signal.Signals
) -> set[ProcessIdentity]:
    """Send a signal to those that still exist; give those that another user owns by now."""
    refused = set()
    for identity in processes:
        try:
            with ProcessHandle.open(identity) as handle:
                handle.send_signal(number)
        except NoSuchProcessError:
            continue
        except PermissionError:  # a setuid program
            refused.add(identity)
    return refused


async def wait_all_ended(processes: Sequence[ProcessIdentity]) -> None:
    """Wait until none of them runs any more; they need not be children of ours."""
    loop = asyncio.get_running_loop()

    def has_ended(pidfd: int, ended: asyncio.Event) -> None:
        loop.remove_reader(pidfd)  # it stays readable
        ended.set()

    with ExitStack() as opened:
        ends = []
        for identity in processes:
            try:
                handle = opened.enter_context(ProcessHandle.open(identity))
            except NoSuchProcessError:
                continue
            ended = asyncio.Event()
            loop.add_reader(handle.fileno(), has_ended, handle.fileno(), ended)
            opened.callback(loop.remove_reader, handle.fileno())
            ends.append(ended)
        for ended in ends:
            await ended.wait()
