"""A process that we started, from its start until nothing of it is left."""

from __future__ import annotations

import asyncio
import logging
import os
import signal
import time
import tty
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING

from play_launch.process.cgroups.group import why_failed, why_killed
from play_launch.process.descendants import (
    group_members,
    in_a_thread,
    session_members,
    signal_each,
    wait_all_ended,
)
from play_launch.process.exit import Exit
from play_launch.process.guard import SpawnError, check_program
from play_launch.process.identity import ProcessIdentity, ProcessStat, read_stat, tracer_of
from play_launch.process.kin import MEMBER_VARIABLE, Kin
from play_launch.process.lines import LineReader, OutputCallback
from play_launch.process.preflight import explained
from play_launch.process.stop import stop
from play_launch.supervisor.events import Stream

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence
    from pathlib import Path

    from play_launch.process.cgroups.group import Group
    from play_launch.process.guard import SessionGuard
    from play_launch.process.stop import StopPolicy

INHERITED = 3
"""The number that a child has the one descriptor under that it gets beside its standard streams.

Ours may be above the limit of its process, see `play_launch.process.open_files`."""
OUTPUT_GRACE = 0.5
"""Seconds that output is read on after everything we could kill is dead."""
_SHORTEST_PAUSE = 0.01
_LONGEST_PAUSE = 1.0
"""Seconds from one question to the next how a process has ended that a tracer holds."""
_TIMES_UNTIL_WARNING = 4
_STRAGGLER_ROUNDS = 5
_STRAGGLER_LIMIT = 1.0

_log = logging.getLogger(__name__)


class Child:
    """A running or ended child: pid, start time and pidfd, its session and its output.

    The child leads its own session and process group. When it ends, the rest of its session is
    killed, its output is read to the end and only then is it waited for, so that until `gone`
    its pid and group number cannot mean another process.

    The end is seen through the pidfd on the event loop: no thread per child (as asyncio has in
    Python 3.11), no SIGCHLD handler.
    """

    def __init__(
        self,
        argv: Sequence[str],
        identity: ProcessIdentity,
        pidfd: int,
        readers: Sequence[LineReader],
        guard: SessionGuard,
        *,
        group: Group | None = None,
        mark: str = "",
    ) -> None:
        self.argv = tuple(argv)
        self.identity = identity
        self.pid = identity.pid
        """It also numbers the process group and the session."""
        self.start_time = identity.start_time
        """Clock ticks after boot (`/proc/<pid>/stat`, field 22)."""
        self.exit: Exit | None = None
        """How it ended; None while it runs."""
        self._pidfd = pidfd
        self._guard = guard
        self._group = group
        self._kin = Kin(identity, guard, mark)
        self._was_killed = False
        self._readers = tuple(readers)
        self._loop = asyncio.get_running_loop()
        self._lost_at: float | None = None
        self._exited = asyncio.Event()
        self._holders = 0
        self._unheld = asyncio.Event()
        self._unheld.set()
        self._gone: asyncio.Future[Exit] = self._loop.create_future()
        self._finishing: asyncio.Task[None] | None = None
        self._loop.add_reader(pidfd, self._on_exit)

    @property
    def is_running(self) -> bool:
        """Whether its end was not seen yet."""
        return self.exit is None

    async def wait(self) -> Exit:
        """Wait until the process itself ends. Output and grandchildren may follow: see `gone`."""
        await self._exited.wait()
        assert self.exit is not None
        return self.exit

    async def gone(self) -> Exit:
        """Wait until nothing is left.

        The process was waited for, the rest of its session killed, all its output delivered
        and every descriptor closed. Output that a process outside the session still holds open
        is closed `OUTPUT_GRACE` seconds after the end.
        """
        return await asyncio.shield(self._gone)

    def send_signal(self, number: signal.Signals) -> bool:
        """Send a signal to the process alone; False when it has ended."""
        if self._pidfd < 0:
            return False
        self._was_killed = self._was_killed or number is signal.SIGKILL
        try:
            signal.pidfd_send_signal(self._pidfd, number)
        except ProcessLookupError:
            return False
        return self.exit is None

    def signal_group(self, number: signal.Signals) -> bool:
        """Send a signal to its whole process group; False when that cannot be reached by number."""
        if self._pidfd < 0:
            return False
        self._was_killed = self._was_killed or number is signal.SIGKILL
        try:
            # No other group has its number until it was waited for, maybe not by us: `Exit.lost`.
            with suppress(PermissionError):
                signal.pidfd_send_signal(self._pidfd, 0)
            os.killpg(self.pid, number)
        except (ProcessLookupError, PermissionError):  # another user's now (setuid programs)
            return False
        return True

    def kill(self) -> None:
        """Kill its group; the rest of its session follows when it has exited."""
        self.signal_group(signal.SIGKILL)

    async def stop(
        self, policy: StopPolicy, *, ask: Callable[[], bool] | None, hurry: asyncio.Event
    ) -> bool:
        """Stop it and its session, see `stop`; False when not even SIGKILL did it in time."""
        outcome = await stop(self, policy, ask=ask, hurry=hurry)
        if outcome.stragglers:
            _log.warning("%r left %d processes, killed", self, outcome.stragglers)
        return outcome.exit is not None

    async def members(self) -> list[ProcessStat]:
        """The other living processes that came of it; none once it is gone.

        Those of its session and group, and what has left them, see `Kin`; in a control group of its
        own, those in there.
        """
        if self._pidfd < 0:
            return []
        if self._group is not None and self._group.holds(self.pid):
            return group_members(self._group, self.pid)
        found = await session_members(self.identity, self._kin, until=self._lost_at)
        return found if self._pidfd >= 0 else []

    def kill_all(self) -> bool:
        """Kill it and its whole session at once; False where it has no control group for that."""
        if self._pidfd < 0 or self._group is None or not self._group.holds(self.pid):
            return False
        self._was_killed = True
        return self._group.kill()

    @contextmanager
    def holding_session(self) -> Iterator[None]:
        """Leave the rest of the session alive when the process ends, until the block is left.

        For a stop that leaves time to its children, too.
        """
        self._holders += 1
        self._unheld.clear()
        try:
            yield
        finally:
            self._holders -= 1
            if self._holders == 0:
                self._unheld.set()

    def _on_exit(self) -> None:
        self._loop.remove_reader(self._pidfd)
        self._finishing = self._loop.create_task(self._finish())

    async def _ended(self) -> Exit:
        asked = 0
        # The zombie stays and with it the number of its group, see signal_group.
        while (ended := await self._guard.ended(self.pid)) is None:
            # A tracer is told first, and when it tells the kernel to go on, the parent.
            if asked == _TIMES_UNTIL_WARNING:
                told = (self.argv[0], self.pid, tracer_of(self.pid) or "another process")
                _log.warning("%s (pid %d) has died, but %s traces it and keeps its end", *told)
            await asyncio.sleep(min(_LONGEST_PAUSE, _SHORTEST_PAUSE * 2**asked))
            asked += 1
        if ended.ok or self._was_killed:
            return ended
        hint = ""
        if self._group is not None:
            is_killed = ended.signal == signal.SIGKILL
            hint = why_killed(self._group) if is_killed else why_failed(self._group)
        return replace(ended, hint=hint) if hint else explained(ended)

    async def _finish(self) -> None:
        exit_ = Exit.lost()
        try:
            try:
                exit_ = await self._ended()
            except ChildProcessError:
                self._lost_at = time.clock_gettime(time.CLOCK_BOOTTIME)
            self.exit = exit_
            self._exited.set()
            await self._unheld.wait()
            await self._kill_rest()
        finally:
            await self._reap()
            if self._group is not None:
                self._group.retire()
            try:
                async with asyncio.timeout(OUTPUT_GRACE):
                    for reader in self._readers:
                        await reader.wait_end()
            except TimeoutError:
                _log.warning(
                    "%s (pid %d) %s, but another process keeps its output open; no longer reading",
                    self.argv[0],
                    self.pid,
                    exit_,
                )
            finally:
                for reader in self._readers:
                    reader.close()
                self._gone.set_result(exit_)

    async def _kill_rest(self) -> None:
        self.kill_all()
        self.signal_group(signal.SIGKILL)
        refused: set[ProcessIdentity] = set()
        # Processes forked meanwhile are found in the next round.
        for _ in range(_STRAGGLER_ROUNDS):
            members = [each for each in await self.members() if each.identity not in refused]
            if not members:
                return
            not_killed = signal_each([each.identity for each in members], signal.SIGKILL)
            refused |= not_killed
            for each in members:
                left = (self.argv[0], self.pid, each.command, each.pid)
                if each.identity in not_killed:
                    why = "which may not be killed: it belongs to another user"
                    _log.error("%s (pid %d) left %s (pid %d), %s", *left, why)
                elif self.pid not in {each.session, each.group}:
                    _log.warning("%s (pid %d) left %s (pid %d), which is killed", *left)
            rest = [each.identity for each in members if each.identity not in refused]
            try:
                async with asyncio.timeout(_STRAGGLER_LIMIT):
                    await wait_all_ended(rest)
            except TimeoutError:
                continue
        _log.error("processes of the session of %s (pid %d) do not die", self.argv[0], self.pid)

    async def _reap(self) -> None:
        pidfd, self._pidfd = self._pidfd, -1
        os.close(pidfd)
        with suppress(ChildProcessError):  # another did, see Exit.lost
            await self._guard.reap(self.pid)

    def __repr__(self) -> str:
        state = "running" if self.exit is None else str(self.exit)
        return f"<Child {self.argv[0]}: pid {self.pid}, start time {self.start_time}, {state}>"


async def spawn(
    argv: Sequence[str],
    *,
    env: Mapping[str, str],
    guard: SessionGuard,
    cwd: Path | None = None,
    descriptors: Mapping[int, int] = MappingProxyType({}),
    on_output: OutputCallback | None = None,
    leaves_by_itself: bool = False,
    emulate_tty: bool = False,
    settings: Sequence[str] = (),
    group: Group | None = None,
    mark: str = "",
) -> Child:
    """Start a program in a session of its own; cancelled, it executes nothing.

    Args:
        argv: The command line; the program is looked up in the PATH of `env`.
        env: The whole environment.
        guard: Becomes its parent, and ends it with everything that came of it when we end.
        cwd: Its working directory.
        descriptors: What it inherits beside its standard streams, by the number that it has there.
        on_output: Gets its lines; None sends its output to /dev/null.
        leaves_by_itself: Whether it exits when the supervisor has exited, see `SessionGuard.spawn`.
        settings: What it asks of the kernel, see `SessionGuard.spawn`.
        group: The control group that it enters by one of the settings: it is killed and removed
            with what is left in it.
        mark: Identifies its daemons, see `Kin`; unique for the guard.
        emulate_tty: Whether it writes to terminals, one for each stream, instead of pipes.

    Raises:
        SpawnError: When it cannot be started: no such program, not executable, too many open
            files. What fails after the guard has taken over appears as exit status 126 or 127.
    """
    try:
        await in_a_thread(partial(check_program, argv, env, cwd))
    except OSError as error:
        raise SpawnError.of(argv, error) from None
    if mark:
        env = {**env, MEMBER_VARIABLE: mark}
    with ExitStack() as opened:
        try:
            pipes: dict[Stream, tuple[int, int]] = {}
            if on_output is not None:
                for stream in Stream:
                    pipes[stream] = ends = _terminal() if emulate_tty else os.pipe()
                    for end in ends:
                        opened.callback(_close_if_open, end)
            nothing = os.open(os.devnull, os.O_RDWR | os.O_CLOEXEC)
            opened.callback(_close_if_open, nothing)
            standard = [nothing, nothing, nothing]
            if pipes:
                standard[1:] = pipes[Stream.STDOUT][1], pipes[Stream.STDERR][1]
            pid = await guard.spawn(
                argv,
                env,
                {**dict(enumerate(standard)), **descriptors},
                leaves_by_itself=leaves_by_itself,
                cwd=cwd,
                settings=settings,
            )
        except OSError as error:
            raise SpawnError.of(argv, error) from None
        except ValueError as error:  # a NUL byte in an argument
            raise SpawnError(argv, str(error)) from None
        try:
            pidfd = os.pidfd_open(pid)
            opened.callback(os.close, pidfd)
            # Not waited for, so /proc shows it even if it has ended already.
            identity = read_stat(pid).identity
        except OSError as error:
            os.kill(pid, signal.SIGKILL)
            raise SpawnError.of(argv, error) from None
        for _, write_end in pipes.values():
            os.close(write_end)
        os.close(nothing)
        opened.pop_all()
    return Child(
        argv,
        identity,
        pidfd,
        [
            LineReader(read_end, partial(on_output, stream))
            for stream, (read_end, _) in pipes.items()
            if on_output is not None
        ],
        guard,
        group=group,
        mark=mark,
    )


def _terminal() -> tuple[int, int]:
    """Open a pseudo-terminal for output only; the ends to read from and to write to."""
    ours, theirs = os.openpty()
    # What is written arrives as it is: no returns before line ends, nothing echoed.
    tty.setraw(theirs)
    return ours, theirs


def _close_if_open(descriptor: int) -> None:
    with suppress(OSError):
        os.close(descriptor)
