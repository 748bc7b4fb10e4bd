"""One process for several isolated containers: starts them in it, and ends it after the last."""

from __future__ import annotations

import asyncio
import logging
import signal
import socket
from dataclasses import replace
from typing import TYPE_CHECKING, Final

import anyio

from play_launch.process.descendants import first_of
from play_launch.process.exit import Exit
from play_launch.process.stop import shorten

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Sequence

    from play_launch.container.channel import ControlChannel
    from play_launch.container.command import SharedKey
    from play_launch.process.cgroups.group import Group
    from play_launch.process.child import Child
    from play_launch.process.lines import Line, OutputCallback
    from play_launch.process.stop import StopPolicy
    from play_launch.supervisor.events import Stream

CONTAINERS_FD_VARIABLE: Final = "PLAY_LAUNCH_CONTAINERS_FD"
"""Has the number of the socket that the process is asked for containers on, see main/process.hpp.

A request is a datagram with the descriptor of the control channel, and a text of parts that end
with NUL: a number, and the command line of the container without the program. When that container
has ended, `NUMBER STATUS STATE` comes back.
"""
_LONGEST_REPLY: Final = 256  # bytes
_HANG_UP_LIMIT: Final = 1.0
"""Seconds for the end of a container whose control channel was closed."""

_MOST_NAMES: Final = 4
"""Containers that are named in one line."""

_log = logging.getLogger(__name__)


class SharedProcess:
    """The process, from its first container to its last."""

    def __init__(self, key: SharedKey) -> None:
        self.key = key
        self.why = ""
        """Why it ends, where one container is the reason; empty: for no such reason."""
        self._culprit = ""
        self._child: Child | None = None
        self._socket: socket.socket | None = None
        self._starting = anyio.Lock()
        self._ending = anyio.Lock()
        self._is_closed = False
        self._members: dict[int, SharedMember] = {}
        self._last = 0
        self._on_output: OutputCallback | None = None

    @property
    def takes_more(self) -> bool:
        """Whether a container can be started in it."""
        return not self._is_closed and (self._child is None or self._child.is_running)

    @property
    def child(self) -> Child:
        """The process itself, which has been started."""
        assert self._child is not None
        return self._child

    async def add(
        self,
        member: SharedMember,
        theirs: int,
        spawn: Callable[[OutputCallback, int], Awaitable[Child]],
    ) -> None:
        """Start a container, and the process if it is the first.

        ``theirs`` is the descriptor of its control channel; ``spawn`` gets what takes the output
        of the process, and the descriptor that it inherits. Cancelled, it starts nothing. Raises
        OSError, also what ``spawn`` does.
        """
        async with self._starting:
            if self._child is None:
                ours, inherited = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
                self._on_output = member.on_output
                with inherited:
                    try:
                        self._child = await spawn(self._output, inherited.fileno())
                    except BaseException:
                        ours.close()
                        raise
                ours.setblocking(False)
                self._socket = ours
                asyncio.get_running_loop().add_reader(ours, self._read)
        if self._socket is None:
            raise BrokenPipeError(0, "its process is ending")
        self._last += 1
        member.number, member.process = self._last, self
        self._members[self._last] = member
        parts = (str(member.number), *member.argv[1:])
        text = "".join(f"{part}\0" for part in parts).encode("utf-8", "surrogateescape")
        try:
            socket.send_fds(self._socket, [text], [theirs])
        except OSError:
            self._is_closed = True
            self.forget(member)
            if not self._members:
                self.child.kill()
            raise

    def others(self, member: SharedMember) -> str:
        """Name the other containers in it, and of many their number; empty without others."""
        names = [each.name for each in self._members.values() if each is not member]
        more = len(names) - _MOST_NAMES
        return ", ".join(names[:_MOST_NAMES]) + (f" and {more} more" if more > 0 else "")

    def explained(self, exit_: Exit, member: SharedMember) -> Exit:
        """Add to the end of a container what its neighbours have to do with it."""
        hints = [exit_.hint]
        if self.why and member.name != self._culprit:
            hints.append(self.why)
        elif exit_.signal and (others := self.others(member)):
            hints.append(f"the same process had {others}")
        return replace(exit_, hint="; ".join(filter(None, hints)))

    def forget(self, member: SharedMember) -> None:
        """Have nothing to do with a container any more."""
        self._members.pop(member.number, None)

    def blame(self, member: SharedMember, what: str) -> None:
        """State which container is the reason for the end of the process, and what it does."""
        self._is_closed = True
        if self.why:
            return
        self._culprit, self.why = member.name, f"{member.name}, which has the same process, {what}"
        if others := self.others(member):
            _log.warning("%s %s: its process ends, and with it %s", member.name, what, others)

    async def gone(self, member: SharedMember) -> None:
        """Wait until nothing is left of a container that has ended; the last ends the process."""
        self.forget(member)
        if not self._members:
            await self.end(member.policy, hurry=asyncio.Event())
        elif not self.child.is_running:
            await self.child.gone()

    async def end(self, policy: StopPolicy, *, hurry: asyncio.Event) -> bool:
        """Stop the process with all containers in it; False when not even SIGKILL did it."""
        self._is_closed = True
        async with self._ending:  # a second signal would cut the first short
            # Without containers, it exits when the socket is closed.
            ask = None if self._members else self._close
            return await self.child.stop(policy, ask=ask, hurry=hurry)

    def _close(self) -> bool:
        if self._socket is not None:
            asyncio.get_running_loop().remove_reader(self._socket)
            self._socket.close()
            self._socket = None
        return True

    def _output(self, stream: Stream, lines: Sequence[Line]) -> None:
        """Give what it prints to the first of its containers."""
        for member in self._members.values():
            self._on_output = member.on_output
            break
        if self._on_output is not None:
            self._on_output(stream, lines)

    def _read(self) -> None:
        """Read which containers have ended."""
        while self._socket is not None:
            try:
                text = self._socket.recv(_LONGEST_REPLY)
            except (BlockingIOError, InterruptedError):
                return
            except OSError:
                text = b""
            if not text:
                self._is_closed = True
                self._close()
                return
            number, status, state = text.decode("ascii").split()
            member = self._members.get(int(number))
            if member is None:
                continue
            if state != "gone":
                self._is_closed = True
            if state == "poisoned":
                self.blame(member, "had a node that died with a lock of the process")
            member.ended(Exit(code=int(status)))
            self.forget(member)
            if state == "poisoned" and self._members:
                self.child.send_signal(signal.SIGTERM)


class SharedMember:
    """Stands for the process of one container among several in it."""

    number = 0
    process: SharedProcess

    def __init__(
        self,
        name: str,
        argv: tuple[str, ...],
        channel: ControlChannel,
        on_output: OutputCallback,
        *,
        group: Group | None,
        policy: StopPolicy,
    ) -> None:
        """``group`` is the control group that the nodes have theirs in."""
        self.name = name
        self.argv = argv
        self.on_output = on_output
        self.policy = policy
        self._channel = channel
        self._group = group
        self._exit: Exit | None = None
        self._ended = asyncio.Event()

    @property
    def pid(self) -> int:
        """Of the process."""
        return self.process.child.pid

    @property
    def start_time(self) -> int:
        """Of the process, in clock ticks after boot."""
        return self.process.child.start_time

    def ended(self, exit_: Exit) -> None:
        """Take how it has ended, in a process that goes on."""
        self._exit = self.process.explained(exit_, self)
        self._ended.set()

    async def wait(self) -> Exit:
        """Wait until it ends, or the process does."""
        if self._exit is None:
            await first_of(self._ended.wait(), self.process.child.wait())
        if self._exit is None:
            assert self.process.child.exit is not None
            self.ended(self.process.child.exit)
        assert self._exit is not None
        return self._exit

    async def gone(self) -> Exit:
        """Wait until nothing of it is left, and of the process if it was the last."""
        exit_ = await self.wait()
        if self._group is not None:
            self._group.kill()
            self._group.retire()
        await self.process.gone(self)
        return exit_

    def kill(self) -> None:
        """Kill the process."""
        self.process.blame(self, "is killed")
        self.process.child.kill()

    async def stop(
        self, policy: StopPolicy, *, ask: Callable[[], bool] | None, hurry: asyncio.Event
    ) -> bool:
        """Stop it alone, and if it does not stop, the process; False if nothing does."""
        if ask is None or not ask():
            self._channel.close()  # upon which it stops
        with anyio.move_on_after(policy.ask or _HANG_UP_LIMIT) as limit:
            async with anyio.create_task_group() as tasks:
                tasks.start_soon(shorten, limit, hurry, policy.hurried)
                await self.wait()
                tasks.cancel_scope.cancel()
        if self._exit is not None:
            return True
        self.process.blame(self, "does not stop")
        return await self.process.end(policy, hurry=hurry)
