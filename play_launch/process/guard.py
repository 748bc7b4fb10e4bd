"""The process that outlives the supervisor and ends what it started: ``spawn_guard --session``.

The protocol is described in ``container_native/src/spawn_guard/session.hpp``. Answers come in the
order of the requests; the event loop goes on meanwhile.
"""

from __future__ import annotations

import array
import asyncio
import atexit
import errno
import os
import shlex
import shutil
import signal
import socket
import struct
import subprocess
import threading
from collections import deque
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, Final, Self

from play_launch.process import open_files
from play_launch.process.exit import Exit
from play_launch.process.identity import ancestors_of
from play_launch.process.time_slice import ask_for_short_turns

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from play_launch.process.identity import ProcessStat

_SPAWN: Final = 1
_STATUS: Final = 2
_REAP: Final = 3
_FAREWELL: Final = 4
_GROUP: Final = 5
_FORGET: Final = 6
_ANSWER: Final = struct.Struct("=3i")
_AT_ONCE: Final = 16
"""Requests that are sent before the first is answered: the kernel bounds what is in a socket."""
_ANSWER_LIMIT: Final = 10.0
"""Seconds after which a guard that does not answer counts as lost."""
_STOPPED_AFTER: Final = 0.1
"""Seconds after which one that does not answer may have been stopped, and is continued."""
_END_LIMIT: Final = 5.0
"""Seconds in which it ends everything; uninterruptible processes may take longer."""


class SpawnError(Exception):
    """A program could not be started.

    Attributes:
        argv: The command line.
        errno: The error number, 0 where the arguments themselves are unusable.
    """

    def __init__(self, argv: Sequence[str], reason: str, errno: int = 0) -> None:
        program = argv[0] if argv else "a program without a name"
        super().__init__(f"cannot start {program}: {reason}")
        self.argv = tuple(argv)
        self.errno = errno

    @classmethod
    def of(cls, argv: Sequence[str], error: OSError) -> SpawnError:
        """Put an error of the system into words."""
        reason = error.strerror or str(error)
        named = error.filename
        if named is not None and str(named) != argv[0]:
            reason = f"{reason}: {named}"
        return cls(argv, reason, error.errno or 0)


def check_program(argv: Sequence[str], env: Mapping[str, str], cwd: Path | None) -> None:
    """Check the program before the guard runs, whose own message would be output.

    Raises:
        OSError: When there is no such program or folder, or it cannot be executed.
    """
    if not argv or not argv[0]:
        raise OSError(0, "the command line is empty")
    if cwd is not None and not cwd.is_dir():
        raise FileNotFoundError(errno.ENOENT, f"its working directory is no directory: {cwd}")
    program = argv[0]
    path = Path(cwd or ".") / program
    if "/" not in program:
        found = shutil.which(program, path=env.get("PATH", os.defpath))
        if found is None:
            raise FileNotFoundError(errno.ENOENT, "no such program in PATH")
        path = Path(found)
    elif not path.exists():
        raise FileNotFoundError(errno.ENOENT, "no such file")
    elif not path.is_file() or not os.access(path, os.X_OK):
        raise PermissionError(errno.EACCES, "it is not an executable file")
    _check_interpreter(path, cwd)


def _check_interpreter(path: Path, cwd: Path | None) -> None:
    """Check what a script names in its first line: Linux would report the script as missing."""
    try:
        # Linux reads as much. What may be executed need not be readable, or not at once.
        with open(os.open(path, os.O_CLOEXEC | os.O_NONBLOCK), "rb") as script:  # noqa: PTH123
            line = script.readline(256)
    except OSError:
        return
    if not line.startswith(b"#!") or not (words := line[2:].split(maxsplit=1)):
        return
    interpreter = Path(cwd or ".") / os.fsdecode(words[0])
    # Perl takes a carriage return behind its options.
    if line.endswith(b"\r\n") and (len(words) == 1 or interpreter.name == "env"):
        reason = f"its lines end with CR LF; fix: sed -i 's/\\r$//' {shlex.quote(str(path))}"
    elif shutil.which(interpreter) is None:
        reason = f"its first line names {interpreter} to run it, which is missing or no program"
    else:
        return
    raise FileNotFoundError(errno.ENOENT, reason)


@dataclass(eq=False, slots=True)
class _Question:
    request: bytes
    descriptors: Sequence[int]
    answer: asyncio.Future[tuple[int, int, int]]


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
        self._started: set[int] = set()
        self._questions: deque[_Question] = deque()
        self._sent = 0
        """How many of the questions have been sent: the first ones."""
        self._loop: asyncio.AbstractEventLoop | None = None
        """The one that reads answers, while there are questions."""
        self._limit: asyncio.TimerHandle | None = None
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
        _keep_exit_statuses()
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with ExitStack() as on_failure, theirs:
            on_failure.callback(ours.close)
            ours.setblocking(False)
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
        # For itself: what it starts shares the processors as anything else does.
        ask_for_short_turns(process.pid, children_too=False)
        return cls(ours, process, answer_limit)

    @property
    def pid(self) -> int:
        return self._process.pid

    @property
    def is_alive(self) -> bool:
        """Whether it runs and can be asked.

        One that is lost may still run. What it has started lives on until `close`.
        """
        return not self._is_lost and self._process.poll() is None

    async def spawn(
        self,
        argv: Sequence[str],
        env: Mapping[str, str],
        descriptors: Mapping[int, int],
        *,
        leaves_by_itself: bool,
        cwd: Path | None = None,
        settings: Sequence[str] = (),
    ) -> int:
        """Start a command in a session of its own; returns its pid. Cancelled, it executes nothing.

        Args:
            argv: The command line.
            env: The whole environment; its PATH is searched.
            descriptors: What it gets, by the number it has there; 0, 1 and 2 among them.
            leaves_by_itself: Whether it exits within 0.7 s when the supervisor has exited.
            cwd: Its working directory, ours by default.
            settings: What it asks of the kernel, see `config.resources`; refusals are left out.

        Raises:
            OSError: When it cannot be started.
            ValueError: When a NUL is in what it should get.
        """
        head = (_SPAWN, leaves_by_itself, len(descriptors))
        request = struct.pack(f"={3 + len(descriptors)}i", *head, *descriptors)
        with _command_file(argv, env, cwd, settings) as command, ExitStack() as opened:
            word, go_ahead = os.pipe()
            for end in (word, go_ahead):
                opened.callback(os.close, end)
            os.set_blocking(go_ahead, False)
            files = (command.fileno(), word, *descriptors.values())
            pid, _, _ = await self._ask(request, files)
            # What is started without it ends: another start may have taken its place.
            os.write(go_ahead, b"\0")
        if pid < 0:
            raise OSError(-pid, os.strerror(-pid))
        self._started.add(pid)
        return pid

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

    async def ended(self, pid: int) -> Exit | None:
        """Return the exit of a process without reaping it; None while it runs.

        Raises:
            ChildProcessError: When it was reaped.
        """
        return await self._wait(_STATUS, pid)

    async def reap(self, pid: int) -> None:
        """Let its pid go; raises ChildProcessError as well."""
        try:
            await self._wait(_REAP, pid)
        finally:
            self._started.discard(pid)

    def has_inherited(self, process: ProcessStat) -> bool:
        """Whether it became a child of this one when its own parent ended.

        When the guard was killed, what it had inherited went to init or a subreaper above us.
        """
        if process.parent == self.pid:
            return process.pid not in self._started
        return process.parent in self._ancestors and self._process.poll() is not None

    async def end(self) -> None:
        """Have everything ended that is left, and wait for that."""
        self._let_go()
        await asyncio.to_thread(self._wait_for_end)

    def close(self) -> None:
        """Do the same where no event loop runs; blocks."""
        self._let_go()
        self._wait_for_end()

    def _let_go(self) -> None:
        self._say_farewell()
        atexit.unregister(self._say_farewell)
        self._lose()
        # Not closed: where an answer cannot be sent, the guard reads nothing behind its request.
        with suppress(OSError):
            self._socket.shutdown(socket.SHUT_WR)
        self._continue()

    def _wait_for_end(self) -> None:
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(_END_LIMIT)
        self._socket.close()

    def _say_farewell(self) -> None:
        # Without it, the end of the socket is our death.
        with suppress(OSError):
            self._send(struct.pack("=i", _FAREWELL), ())

    async def _wait(self, request: int, pid: int) -> Exit | None:
        try:
            result, code, status = await self._ask(struct.pack("=2i", request, pid))
        except OSError as error:
            raise ChildProcessError(*error.args) from None
        if result < 0:
            raise ChildProcessError(-result, os.strerror(-result))
        return Exit.of(code, status) if result else None

    async def _ask(self, request: bytes, descriptors: Sequence[int] = ()) -> tuple[int, int, int]:
        """Send a request in its turn and wait for the answer; raises OSError."""
        if self._is_lost:
            raise _loss()
        loop = asyncio.get_running_loop()
        if self._loop is not loop:
            self._loop = loop
            loop.add_reader(self._socket, self._read)
        question = _Question(request, descriptors, loop.create_future())
        self._questions.append(question)
        self._send_more()
        if self._limit is None:
            self._await_next()
        try:
            return await asyncio.shield(question.answer)
        except asyncio.CancelledError:
            self._give_up(question)
            raise

    def _give_up(self, question: _Question) -> None:
        if question in self._questions and self._questions.index(question) >= self._sent:
            self._questions.remove(question)
        elif struct.unpack_from("=i", question.request) == (_SPAWN,):
            question.answer.add_done_callback(self._forget)

    def _forget(self, answer: asyncio.Future[tuple[int, int, int]]) -> None:
        """Leave it to the guard to wait for what ends without a go-ahead."""
        if answer.exception() is None and answer.result()[0] > 0:
            with suppress(OSError):
                self._send(struct.pack("=2i", _FORGET, answer.result()[0]), ())

    def _send_more(self) -> None:
        while self._sent < min(_AT_ONCE, len(self._questions)):
            question = self._questions[self._sent]
            try:
                self._send(question.request, question.descriptors)
            except OSError as error:
                if not self._is_lost:
                    self._questions.remove(question)
                    question.answer.set_exception(error)
            else:
                self._sent += 1

    def _read(self) -> None:
        answer = b""
        with suppress(OSError):
            answer = self._socket.recv(_ANSWER.size)
        if len(answer) != _ANSWER.size:
            self._lose()
            return
        self._sent -= 1
        self._questions.popleft().answer.set_result(_ANSWER.unpack(answer))
        self._send_more()
        self._await_next()

    def _await_next(self) -> None:
        """Begin the time in which the next answer has to come, if there are questions."""
        if self._limit is not None:
            self._limit.cancel()
            self._limit = None
        if self._loop is None:
            return
        if not self._questions:
            self._loop.remove_reader(self._socket)
            self._loop = None
        elif self._answer_limit > _STOPPED_AFTER:
            self._limit = self._loop.call_later(_STOPPED_AFTER, self._overdue, self._loop)
        else:
            self._limit = self._loop.call_later(self._answer_limit, self._lose)

    def _overdue(self, loop: asyncio.AbstractEventLoop) -> None:
        self._continue()
        self._limit = loop.call_later(self._answer_limit - _STOPPED_AFTER, self._lose)

    def _lose(self) -> None:
        """Ask it no more: what comes late would be taken for the answer to another question."""
        self._is_lost = True
        questions, self._questions, self._sent = self._questions, deque(), 0
        if self._loop is not None and self._loop.is_closed():
            self._loop, self._limit = None, None
            return
        for each in questions:
            each.answer.set_exception(_loss())
        self._await_next()

    def _continue(self) -> None:
        # It is the parent of our containers, whose nodes can send it signals.
        self._process.send_signal(signal.SIGCONT)

    def _send(self, request: bytes, descriptors: Sequence[int]) -> None:
        """Send without waiting; raises OSError."""
        if self._is_lost:
            raise _loss()
        rights = (socket.SOL_SOCKET, socket.SCM_RIGHTS, array.array("i", descriptors))
        try:
            self._socket.sendmsg([request], [rights] if descriptors else [])
        except (BlockingIOError, ConnectionError):
            self._lose()
            raise _loss() from None


def _loss() -> OSError:
    return ConnectionResetError(errno.ECONNRESET, "the guard of the session does not answer")


def _command_file(
    argv: Sequence[str], env: Mapping[str, str], cwd: Path | None, settings: Sequence[str]
) -> BinaryIO:
    """Write a command as ``container_native/src/spawn_guard/command_file.hpp`` reads it.

    It is in memory: a message of the socket would have a limit.
    """
    variables = [f"{name}={value}" for name, value in env.items()]
    folders = () if cwd is None else (os.fspath(cwd),)
    texts = [os.fsencode(text) for text in (*argv, *variables, *folders, *settings)]
    if any(b"\0" in text for text in texts):
        raise ValueError("embedded null byte")
    counts = struct.pack("=4I", len(argv), len(variables), len(folders), len(settings))
    file = open(os.memfd_create("command", os.MFD_CLOEXEC), "wb")  # noqa: PTH123, SIM115
    file.write(counts + b"".join(text + b"\0" for text in texts))
    file.flush()
    return file


def _keep_exit_statuses() -> None:
    """Undo an ignored SIGCHLD, by which the kernel would reap: a parent may have left us one."""
    if (
        signal.getsignal(signal.SIGCHLD) is signal.SIG_IGN
        and threading.current_thread() is threading.main_thread()
    ):
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
