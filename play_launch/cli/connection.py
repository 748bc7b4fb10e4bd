"""Connection of a command to a running session: finding it, its errors, its end, its ROS.

These commands import as little as they can: they are called often.
"""

from __future__ import annotations

import contextlib
import os
import sys
import time
from typing import TYPE_CHECKING, Final, NoReturn

from play_launch import ExitCode
from play_launch.cli.output import note, redirect_to_devnull, report
from play_launch.control.protocol import ROS_VARIABLES, Code, OperationError
from play_launch.control.sessions import AmbiguousSessionError, NoSessionError, connect, connect_to
from play_launch.recording.folder import CONTROL_SOCKET

if TYPE_CHECKING:
    from collections.abc import Iterator

    from play_launch.control.client import ControlClient, SessionInfo

_POLL: Final = 0.05
_SILENT: Final = 1.0
"""Seconds for which a wait for a session is not worth a line."""
_EXIT_CODES: Final = {
    Code.BAD_ARGUMENTS: ExitCode.USAGE,
    Code.UNKNOWN_NAME: ExitCode.USAGE,
    Code.AMBIGUOUS_NAME: ExitCode.USAGE,
    Code.TIMEOUT: ExitCode.TIMEOUT,
}


@contextlib.contextmanager
def connected(
    session: str | None,
    *,
    deadline: float | None = None,
    failed: ExitCode = ExitCode.NODE_FAILED,
) -> Iterator[ControlClient]:
    """Connect to a session for the block; its errors are reported and end the process.

    ``deadline`` is until when to wait for a session, on the monotonic clock; ``failed`` is the exit
    code where a request failed.
    """
    try:
        with _connect(session, deadline) as client:
            yield client
        sys.stdout.flush()
    except NoSessionError as error:
        _end([str(error)], failed)
    except OperationError as error:
        _end(_messages(error), _EXIT_CODES.get(error.code, failed))
    except BrokenPipeError:
        # The reader has enough (`| head`).
        redirect_to_devnull(sys.stdout)
        sys.exit(ExitCode.OK)


def _connect(session: str | None, deadline: float | None) -> ControlClient:
    if deadline is None:
        return connect(session)
    tell_at = time.monotonic() + _SILENT
    while True:
        left = deadline - time.monotonic()
        try:
            return connect(session, limit=max(left, _POLL))
        except AmbiguousSessionError:
            raise
        except NoSessionError:
            if left < _POLL:
                raise
            if time.monotonic() > tell_at:
                note(f"waiting for {f'session {session}' if session else 'a session'}")
                tell_at = deadline
            time.sleep(_POLL)


def report_end(hello: SessionInfo, reason: str = "") -> int:
    """Report how a session ended that closed its connection; return the exit code.

    ``reason`` is why its client gave up; empty: the connection was closed.
    """
    text, status = _how_it_ended(hello, reason)
    if status == ExitCode.OK:
        note(text)
    else:
        report(text)
    return status


def _how_it_ended(hello: SessionInfo, reason: str) -> tuple[str, ExitCode]:
    name = f"session {hello.name} (pid {hello.pid})"
    try:
        connect_to(hello.folder).close()
    except NoSessionError:
        # A session that ends in order removes its socket first.
        if os.path.lexists(f"{hello.folder}/{CONTROL_SOCKET}"):
            return f"the supervisor of the {name} was killed", ExitCode.NODE_FAILED
        return f"the {name} has ended", ExitCode.OK
    except OperationError as error:
        return str(error), ExitCode.NODE_FAILED
    end = f"the {name} closed the connection{': ' if reason else ''}{reason}"
    return end, ExitCode.NODE_FAILED


def _messages(error: OperationError) -> list[str]:
    """List the failures of an operation, one for each unit."""
    results = error.details.get("results")
    if error.code != Code.FAILED or not isinstance(results, list):
        return [str(error)]
    failed = [f"{each['name']}: {each['reason']}" for each in results if not each["done"]]
    return failed or [str(error)]


def _end(messages: list[str], code: ExitCode) -> NoReturn:
    for message in messages:
        report(message)
    sys.exit(code)


def enter_environment_of(client: ControlClient) -> None:
    """Set what the session says about ROS; before anything of rclpy is imported.

    Root becomes the user of the session before that: profiles and middleware, which that user
    chooses, load libraries. Raises OperationError.
    """
    from play_launch.process.preflight import full_shared_memory  # noqa: PLC0415 - slow

    if full := full_shared_memory():
        raise OperationError(Code.REFUSED, full)
    found = client.ask("environment")
    user = client.peer()
    if os.geteuid() == 0 and user.uid != 0:
        try:
            _become(user.uid, user.gid)
        except OSError as error:
            raise OperationError(
                Code.REFUSED, f"run this as user {user.uid}, whose session it is: {error}"
            ) from None
    for name in [name for name in os.environ if name.startswith(ROS_VARIABLES)]:
        del os.environ[name]
    # What it says besides is not taken over: LD_LIBRARY_PATH would choose libraries.
    os.environ.update(
        {name: str(value) for name, value in found.items() if name.startswith(ROS_VARIABLES)}
    )
    try:
        import rclpy  # noqa: F401, PLC0415
    except ImportError as error:
        raise OperationError(
            Code.REFUSED, f"ROS cannot be loaded as user {os.geteuid()}: {error}"
        ) from None


def _become(user: int, group: int) -> None:
    """Become a user for good, with home and groups."""
    import pwd  # noqa: PLC0415 - for root only

    groups, home = [group], "/"
    try:
        entry = pwd.getpwuid(user)
        groups, home = os.getgrouplist(entry.pw_name, group), entry.pw_dir
    except KeyError:
        pass  # a user of a container, without a name here
    os.setgroups(groups)
    os.setresgid(group, group, group)
    os.setresuid(user, user, user)
    os.environ["HOME"] = home
