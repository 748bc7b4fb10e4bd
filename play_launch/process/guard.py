"""The process that outlives the supervisor and ends what it started: ``spawn_guard --session``.

The protocol is described in ``container_native/src/spawn_guard/session.hpp``. Every request is
answered within a few milliseconds, like a fork of our own, so it may be made on the loop's thread:
the guard does not wait until a program is executed, whose disk may take long.
"""

from __future__ import annotations

import array
import atexit
import errno
import os
import signal
import socket
import struct
import subprocess
from contextlib import ExitStack, suppress
from typing import TYPE_CHECKING, BinaryIO, Final, Protocol, Self

from play_launch.process import open_files
from play_launch.process.exit import Exit
from play_launch.process.time_slice import ask_for_short_turns, run_ahead

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from play_launch.process.identity import ProcessStat
    from play_launch.process.zygote import Zygote

_SPAWN: Final = 1
_STATUS: Final = 2
_REAP: Final = 3
_HELPER: Final = 4
_FAREWELL: Final = 5
_GROUP: Final = 6
_ANSWER: Final = struct.Struct("=3i")
_ANSWER_LIMIT: Final = 10.0
"""Seconds after which a guard that does not answer counts as lost."""
_STOPPED_AFTER: Final = 0.1
"""Seconds after which one that does not answer may have been stopped, and is continued."""
_END_LIMIT: Final = 5.0
"""Seconds in which it ends everything; uninterruptible processes may take longer."""


class Parent(Protocol):
    """Who can wait for a process."""

    def ended(self, pid: int) -> Exit | None:
        """Say how it ended and leave it a zombie; None while it runs.

        Raises:
            ChildProcessError: When nobody can say any more.
        """

    def reap(self, pid: int) -> None:
        """Let its pid go; raises ChildProcessError as well."""

    def has_inherited(self, process: ProcessStat) -> bool:
        """Whether it became a child of this one when its own parent ended."""


class Ourselves:
    """The parent of what this process has forked."""

    def ended(self, pid: int) -> Exit | None:
        """See `Parent`."""
        # WNOWAIT: the zombie stays, and with it its pid and the number of its group.
        result = os.waitid(os.P_PID, pid, os.WEXITED | os.WNOHANG | os.WNOWAIT)
        return None if result is None else Exit.of(result.si_code, result.si_status)

    def reap(self, pid: int) -> None:
        """See `Parent`."""
        os.waitid(os.P_PID, pid, os.WEXITED | os.WNOHANG)

    def has_inherited(self, process: ProcessStat) -> bool:
        """See `Parent`; we are no subreaper."""
        del process
        return False


class SessionGuard:
    """The parent of everything that a session starts, in a process of its own.

    When our end of the socket closes, also because we were killed, it kills whatever came of what
    it has started, and ends. Belongs to one thread.
    """

    def __init__(
        self, ours: socket.socket, process: subprocess.Popen[bytes], answer_limit: float
    ) -> None:
        self._socket = ours
        self._process = process
        self._answer_limit = answer_limit
        self._is_lost = False
        self._helpers = 0
        self._started: set[int] = set()
        from play_launch.process.identity import ancestors_of  # noqa: PLC0415 - it runs by now

        self._ancestors = ancestors_of(os.getpid())
        atexit.register(self._say_farewell)

    @classmethod
    def start(
        cls,
        program: Path,
        *,
        afterwards: Sequence[str] = (),
        answer_limit: float = _ANSWER_LIMIT,
    ) -> Self:
        """Start it; raises OSError.

        Args:
            program: The guard.
            afterwards: A command that it starts when we have died and it has ended everything.
            answer_limit: Seconds; it is lost when an answer takes longer.
        """
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with ExitStack() as on_failure, theirs:
            on_failure.callback(ours.close)
            ours.settimeout(answer_limit)
            number = theirs.fileno()
            process = subprocess.Popen(
                [program, "--session", str(number), *(["--", *afterwards] if afterwards else [])],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                pass_fds=(number,),
                # What is sent to our group or our terminal is not meant for it.
                start_new_session=True,
            )
            on_failure.pop_all()
        # Before it is asked for anything: all that it starts inherits its limit.
        open_files.give_back(process.pid)
        # We wait for its answers, and what it starts shares the processors as anything else does.
        if not run_ahead(process.pid):
            ask_for_short_turns(process.pid, children_too=False)
        return cls(ours, process, answer_limit)

    @property
    def pid(self) -> int:
        """Its pid."""
        return self._process.pid

    @property
    def is_alive(self) -> bool:
        """Whether it runs and can be asked.

        One that is lost may still run. What it has started lives on until `close`.
        """
        return not self._is_lost and self._process.poll() is None

    def spawn(
        self,
        argv: Sequence[str],
        env: Mapping[str, str],
        descriptors: Mapping[int, int],
        *,
        leaves_by_itself: bool,
        zygote: Zygote | None = None,
        cwd: Path | None = None,
        settings: Sequence[str] = (),
    ) -> int:
        """Start a command in a session of its own; returns its pid.

        Args:
            argv: The command line.
            env: The whole environment; its PATH is searched.
            descriptors: What it gets, by the number it has there; 0, 1 and 2 among them.
            leaves_by_itself: Whether it ends by itself, within 0.7 s, when we are gone.
            zygote: Who is forked for it; if that fails, the command is executed, and the zygote
                is lost.
            cwd: Its working directory, ours by default; not with a zygote.
            settings: What it asks of the kernel for itself, see `config.resources`; what
                is refused is left out.

        Raises:
            OSError: When it cannot be started.
            ValueError: When a NUL is in what it should get.
        """
        helper = () if zygote is None else (zygote.fileno(),)
        head = (_SPAWN, leaves_by_itself, 0 if zygote is None else zygote.number, len(descriptors))
        request = struct.pack(f"={4 + len(descriptors)}i", *head, *descriptors)
        with _file(_command(argv, env, cwd, settings)) as command, ExitStack() as opened:
            word, go_ahead = os.pipe()
            for end in (word, go_ahead):
                opened.callback(os.close, end)
            os.set_blocking(go_ahead, False)
            files = (command.fileno(), word, *helper, *descriptors.values())
            pid, obstacle, _ = self._ask(request, files)
            # What is started without it ends: another start may have taken its place.
            os.write(go_ahead, b"\0")
        if zygote is not None and obstacle:
            zygote.lose(os.strerror(obstacle))
        if pid < 0:
            raise OSError(-pid, os.strerror(-pid))
        self._started.add(pid)
        return pid

    def spawn_helper(
        self, argv: Sequence[str], env: Mapping[str, str], descriptors: Mapping[int, int]
    ) -> int:
        """Start a command of which nothing is heard; does not wait for that. Returns its number."""
        request = struct.pack(f"={2 + len(descriptors)}i", _HELPER, len(descriptors), *descriptors)
        with _file(_command(argv, env)) as command:
            self._send(request, (command.fileno(), *descriptors.values()))
        self._helpers += 1
        return self._helpers

    def entrust(self, group: Path) -> None:
        """Have it remove a control group, with all that is in it, should we die.

        Args:
            group: Its folder; of several, the last.

        Raises:
            OSError: When it is not there.
        """
        folder = os.open(group, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            self._send(struct.pack("=i", _GROUP), (folder,))
        finally:
            os.close(folder)

    def ended(self, pid: int) -> Exit | None:
        """See `Parent`."""
        return self._wait(_STATUS, pid)

    def reap(self, pid: int) -> None:
        """See `Parent`."""
        self._started.discard(pid)
        self._wait(_REAP, pid)

    def has_inherited(self, process: ProcessStat) -> bool:
        """See `Parent`; helpers count as inherited as well.

        When the guard was killed, what it had inherited went to init or a subreaper above us.
        """
        if process.parent == self.pid:
            return process.pid not in self._started
        return process.parent in self._ancestors and self._process.poll() is not None

    def close(self) -> None:
        """Have everything ended that is left, and wait for that; blocks."""
        self._say_farewell()
        atexit.unregister(self._say_farewell)
        self._socket.close()
        self._continue()
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(_END_LIMIT)

    def _say_farewell(self) -> None:
        # Without it, the end of the socket is our death.
        with suppress(OSError):
            self._send(struct.pack("=i", _FAREWELL), ())

    def _wait(self, request: int, pid: int) -> Exit | None:
        try:
            result, code, status = self._ask(struct.pack("=2i", request, pid))
        except OSError as error:
            raise ChildProcessError(*error.args) from None
        if result < 0:
            raise ChildProcessError(-result, os.strerror(-result))
        return Exit.of(code, status) if result else None

    def _ask(self, request: bytes, descriptors: Sequence[int] = ()) -> tuple[int, int, int]:
        self._send(request, descriptors)
        answer = b""
        if not self._is_lost:
            with suppress(TimeoutError, ConnectionError):
                answer = self._receive()
            # Whatever comes later would be taken for the answer to another request.
            self._is_lost = len(answer) != _ANSWER.size
        if self._is_lost:
            raise ConnectionResetError(errno.ECONNRESET, "the guard of the session does not answer")
        result, code, status = _ANSWER.unpack(answer)
        return result, code, status

    def _receive(self) -> bytes:
        limit = self._answer_limit
        if limit > _STOPPED_AFTER:
            self._socket.settimeout(_STOPPED_AFTER)
            try:
                return self._socket.recv(_ANSWER.size)
            except TimeoutError:
                self._continue()
            finally:
                self._socket.settimeout(limit)
        return self._socket.recv(_ANSWER.size)

    def _continue(self) -> None:
        # It is the parent of our containers, whose nodes can send it signals.
        self._process.send_signal(signal.SIGCONT)

    def _send(self, request: bytes, descriptors: Sequence[int]) -> None:
        rights = (socket.SOL_SOCKET, socket.SCM_RIGHTS, array.array("i", descriptors))
        if not self._is_lost:
            try:
                self._socket.sendmsg([request], [rights] if descriptors else [])
            except (TimeoutError, ConnectionError):
                self._is_lost = True


def _command(
    argv: Sequence[str],
    env: Mapping[str, str],
    cwd: Path | None = None,
    settings: Sequence[str] = (),
) -> bytes:
    """Write a command as ``container_native/src/base/command_file.hpp`` reads it."""
    variables = [f"{name}={value}" for name, value in env.items()]
    folders = () if cwd is None else (os.fspath(cwd),)
    texts = [os.fsencode(text) for text in (*argv, *variables, *folders, *settings)]
    if any(b"\0" in text for text in texts):
        msg = "embedded null byte"
        raise ValueError(msg)
    counts = struct.pack("=4I", len(argv), len(variables), len(folders), len(settings))
    return counts + b"".join(text + b"\0" for text in texts)


def _file(content: bytes) -> BinaryIO:
    """Put bytes into a file in memory: a message of the socket would have a limit."""
    file = open(os.memfd_create("command", os.MFD_CLOEXEC), "wb")  # noqa: PTH123, SIM115
    file.write(content)
    file.flush()
    return file
