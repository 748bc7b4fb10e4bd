"""A machine as the coordinator reaches it: by ssh, or as this one.

Commands run in a bash that reads no start-up files, and what they print begins behind a marker:
the shell of the user may print a greeting first.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import shlex
import socket
import stat
import time
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple, Protocol, TypeAlias

import anyio
from msgspec.structs import replace

from play_launch import UserError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from play_launch.config.machines import MachineConfig

_log = logging.getLogger(__name__)
Arrived: TypeAlias = "Callable[[int, int], None]"
"""Takes the bytes that have arrived, and those that there are."""
_MARKER: Final = "==play-launch=="
_KEEPALIVES: Final = 3
"""Unanswered ones, after which ssh gives a connection up; the last is waited for as well."""
_WINDOW: Final = 32 * 1024
"""Bytes of a channel on their way at most: a stop must not wait for the lines of a node that
writes more than the link carries."""
_COMMAND_LIMIT: Final = 60.0
"""Seconds for a command: the check of a configuration from a cold disk."""
_CLOSE_LIMIT: Final = 1.0
_ATTEMPT: Final = 10.0
"""Seconds of the first attempt to connect; the next ones may take 20 s, 40 s, ..."""
_PAUSE: Final = 0.5
"""Seconds between two."""
_ABOUT: Final = """\
printf '%s\\n' "$HOME" "$(cat /proc/sys/kernel/random/boot_id)" \
"${PLAY_LAUNCH_SESSIONS_DIR:-/dev/shm/play_launch-$(id -u)}"
"""


class HostError(UserError):
    """A machine cannot be used; the text has the fix."""


class LinkLost(Exception):  # noqa: N818 - it is no mistake
    """The connection to a machine was lost, or cannot be made at the moment."""


class SessionGone(LinkLost):
    """The session of a machine does not answer, while the machine does."""

    def __init__(self, reason: str = "it has just ended") -> None:
        super().__init__(f"its session does not answer: {reason}")


class Printed(NamedTuple):
    """What a command printed."""

    status: int
    stdout: str
    stderr: str


class About(NamedTuple):
    """Facts about a machine."""

    home: str
    boot: str
    """Differs after a reboot."""
    links: str
    """Folder with the links of running sessions."""


class Reader(Protocol):
    """The reading end of asyncio's connections, and of asyncssh's."""

    async def read(self, n: int, /) -> bytes: ...


class Host(Protocol):
    """A connection to a machine; all methods raise `LinkLost`."""

    address: str
    """Address by which other machines reach it; empty where unknown."""

    async def run(
        self, script: str, limit: float | None = _COMMAND_LIMIT, data: bytes = b""
    ) -> Printed:
        """Run a script with `data` as its input, for `limit` seconds at most."""
        ...

    async def get(self, folder: str, target: Path, arrived: Arrived) -> None:
        """Make the files of `target` those of a folder, and report how much has arrived so far.

        What an earlier call has copied is not copied again.
        """
        ...

    async def open(self, path: str) -> tuple[Reader, Any]:
        """Connect to the socket of a session; raises SessionGone where nothing listens."""
        ...

    async def close(self) -> None: ...


async def about(host: Host) -> About:
    output = await host.run(_ABOUT)
    return About(*output.stdout.splitlines()[:3])


async def connect(machine: MachineConfig) -> Host:
    """Connect to a machine; raises HostError where a person has to act, and LinkLost."""
    return LocalHost() if machine.local else await SshHost.connect(machine)


async def connect_at_first(machine: MachineConfig) -> tuple[Host, About]:
    """Connect, as often as `connect_timeout` permits: it may just be booted.

    Raises HostError where a person has to act, and LinkLost.
    """
    left, attempt = machine.connect_timeout, _ATTEMPT
    deadline = time.monotonic() + left
    is_reported = False
    while True:
        try:
            host = await connect(replace(machine, connect_timeout=min(left, attempt)))
            try:
                return host, await about(host)
            except BaseException:
                await host.close()
                raise
        except LinkLost as lost:
            text = f"it does not answer: {lost}"
        # A machine that is up by now is found by the next attempt; a slow login needs a longer one.
        attempt *= 2
        left = deadline - time.monotonic() - _PAUSE
        if left <= 0:
            raise LinkLost(f"{text}; try `ssh {machine.ssh or machine.name} true`")
        if not is_reported:
            is_reported = True
            _log.warning("%s: %s; it is tried for %.0f s more", machine.name, text, left)
        await asyncio.sleep(_PAUSE)


def _missing_in(target: Path, files: Mapping[str, tuple[int, int]]) -> dict[str, int]:
    """Remove the files of another name, and give the sizes of those that are missing or differ.

    `files` are sizes and times of change, in seconds, by name.
    """
    target.mkdir(parents=True, exist_ok=True)
    present = {}
    for each in target.iterdir():
        if each.name in files:
            present[each.name] = _size_and_change(each)
        elif not each.is_dir():
            each.unlink()
    return {name: known[0] for name, known in files.items() if present.get(name) != known}


def _size_and_change(path: Path) -> tuple[int, int]:
    found = path.stat()
    return found.st_size, int(found.st_mtime)


def _half(path: Path) -> Path:
    """Where a file is until it is whole."""
    return path.with_name(f".{path.name}")


def _copy_files(folder: Path, target: Path) -> None:
    """Copy the files of a folder, and not its sockets."""
    import shutil  # noqa: PLC0415 - rarely needed

    files = {each.name: _size_and_change(each) for each in folder.iterdir() if each.is_file()}
    for name in _missing_in(target, files):
        half = _half(target / name)
        shutil.copy2(folder / name, half)
        half.replace(target / name)


def _marked(script: str) -> str:
    return f"echo {_MARKER}\n{script}"


def _output(status: int, stdout: bytes, stderr: bytes) -> Printed:
    said, why = (each.decode(errors="replace") for each in (stdout, stderr))
    return Printed(status, said.partition(f"{_MARKER}\n")[2], why.strip())


class LocalHost:
    """This machine."""

    address = ""

    async def run(
        self, script: str, limit: float | None = _COMMAND_LIMIT, data: bytes = b""
    ) -> Printed:
        process = await asyncio.create_subprocess_exec(
            *("bash", "--norc", "--noprofile", "-c", _marked(script)),
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
        )
        try:
            async with asyncio.timeout(limit):
                stdout, stderr = await process.communicate(data)
        except TimeoutError:
            return Printed(124, "", f"it took longer than {limit:g} s")
        finally:
            if process.returncode is None:  # it took too long, or is not waited for
                process.kill()
                with anyio.CancelScope(shield=True):
                    await process.wait()
        return _output(process.returncode or 0, stdout, stderr)

    async def get(self, folder: str, target: Path, arrived: Arrived) -> None:  # noqa: ARG002 - it takes no time
        await asyncio.to_thread(_copy_files, Path(folder), target)

    async def open(self, path: str) -> tuple[Reader, Any]:
        try:
            folder = os.open(os.path.dirname(path), os.O_PATH | os.O_DIRECTORY)  # noqa: PTH120
        except OSError as error:
            raise SessionGone(str(error)) from None
        connection = socket.socket(socket.AF_UNIX)
        connection.setblocking(False)
        try:
            # An address has at most 107 bytes.
            connection.connect(f"/proc/self/fd/{folder}/{Path(path).name}")
        except OSError as error:
            connection.close()
            raise SessionGone(str(error)) from None
        finally:
            os.close(folder)
        return await asyncio.open_unix_connection(sock=connection)

    async def close(self) -> None:
        """Do nothing: there is no connection."""


def _add(arrived: Arrived, before: int, total: int, _from: bytes, _to: bytes, *sizes: int) -> None:
    arrived(before + sizes[0], total)


class SshHost:
    """A machine that ssh reaches."""

    def __init__(self, name: str, connection: Any) -> None:
        self._name = name
        self._connection = connection
        peer = connection.get_extra_info("peername")
        self.address = str(peer[0]) if peer else ""

    @classmethod
    async def connect(cls, machine: MachineConfig) -> SshHost:
        try:
            import asyncssh  # noqa: PLC0415 - slow, and an extra
        except ImportError:
            raise HostError(
                "machines are reached by asyncssh, which is not installed: "
                "pip install 'play-launch-py[machines]'"
            ) from None
        user, _, name = (machine.ssh or machine.name).rpartition("@")
        try:
            connection = await asyncssh.connect(
                name,
                **({"username": user} if user else {}),
                keepalive_interval=machine.lost_after / (_KEEPALIVES + 1),
                keepalive_count_max=_KEEPALIVES,
                connect_timeout=machine.connect_timeout,
                login_timeout=machine.connect_timeout,
            )
        except asyncssh.HostKeyNotVerifiable:
            raise HostError(
                f"its host key is unknown, or has changed; compare it and accept it with "
                f"`ssh {name} true` (a machine that was set up anew: `ssh-keygen -R {name}` first)"
            ) from None
        except asyncssh.PermissionDenied:
            raise HostError(
                f"ssh does not let you in; try `ssh-copy-id {name}`, and `ssh-add` for a key "
                "with a passphrase"
            ) from None
        except socket.gaierror as error:
            raise HostError(
                f"the name {name} is not known ({error.strerror}); give it an alias in "
                "~/.ssh/config, or the address in ssh"
            ) from None
        except (OSError, asyncssh.Error, TimeoutError) as error:
            raise LinkLost(_reason(error)) from None
        except ValueError as error:  # of ~/.ssh/config
            raise HostError(f"~/.ssh/config cannot be used: {error}") from None
        return cls(name, connection)

    async def run(
        self, script: str, limit: float | None = _COMMAND_LIMIT, data: bytes = b""
    ) -> Printed:
        command = f"exec bash --norc --noprofile -c {shlex.quote(_marked(script))}"
        with self._losses():
            found = await self._connection.run(command, input=data, timeout=limit, encoding=None)
        status = 255 if found.exit_status is None else found.exit_status
        return _output(status, found.stdout, found.stderr)

    async def get(self, folder: str, target: Path, arrived: Arrived) -> None:
        with self._losses():
            async with self._connection.start_sftp_client() as sftp:
                files = {
                    each.filename: (each.attrs.size, each.attrs.mtime)
                    for each in await sftp.readdir(folder)
                    # The other machine chooses the names.
                    if each.filename == Path(each.filename).name
                    and stat.S_ISREG(each.attrs.permissions or 0)
                }
                sizes = await asyncio.to_thread(_missing_in, target, files)
                before, total = 0, sum(sizes.values())
                for name, size in sizes.items():
                    half = _half(target / name)
                    done = partial(_add, arrived, before, total)
                    await sftp.get(f"{folder}/{name}", half, preserve=True, progress_handler=done)
                    await asyncio.to_thread(half.replace, target / name)
                    before += size

    async def open(self, path: str) -> tuple[Reader, Any]:
        import asyncssh  # noqa: PLC0415 - it is imported

        with self._losses():
            try:
                return await self._connection.open_unix_connection(  # type: ignore[no-any-return]
                    path, window=_WINDOW
                )
            except asyncssh.ChannelOpenError as error:
                raise SessionGone(error.reason) from None

    async def close(self) -> None:
        self._connection.close()
        # asyncio warns of the program of a ProxyCommand that outlives the event loop.
        with anyio.move_on_after(_CLOSE_LIMIT, shield=True):
            await self._connection.wait_closed()

    @contextlib.contextmanager
    def _losses(self) -> Any:
        """Turn what asyncssh raises where a connection is lost into `LinkLost`."""
        import asyncssh  # noqa: PLC0415 - it is imported

        try:
            yield
        except HostError:
            raise
        except asyncssh.SFTPError as error:
            lost = isinstance(error, asyncssh.SFTPConnectionLost | asyncssh.SFTPNoConnection)
            if lost:
                raise LinkLost(_reason(error)) from None
            raise HostError(f"files cannot be read there: {error.reason}") from None
        except (OSError, asyncssh.Error, TimeoutError) as error:
            raise LinkLost(_reason(error)) from None


def _reason(error: Exception) -> str:
    return getattr(error, "reason", "") or getattr(error, "strerror", "") or str(error) or "timeout"
