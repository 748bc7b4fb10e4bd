"""Connection of a command to a running session: finding it, its errors, its end.

These commands import as little as they can: they are called often.
"""

from __future__ import annotations

import contextlib
import os
import sys
import time
from typing import TYPE_CHECKING, Final, NoReturn

from play_launch.cli.output import printable
from play_launch.control.protocol import Code, ControlError
from play_launch.control.registration import CONTROL_SOCKET
from play_launch.control.sessions import AmbiguousSessionError, NoSessionError, connect, connect_to
from play_launch.supervisor.exit_code import ExitCode

if TYPE_CHECKING:
    from collections.abc import Iterator

    from play_launch.control.client import ControlClient, Hello

_POLL: Final = 0.05
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

    Args:
        session: Folder, name or pid; None: the only one.
        deadline: Until when to wait for a session, on the monotonic clock.
        failed: Exit code where a request failed.
    """
    try:
        with _connect(session, deadline) as client:
            yield client
        sys.stdout.flush()
    except NoSessionError as error:
        _end([str(error)], failed)
    except ControlError as error:
        _end(_messages(error), _EXIT_CODES.get(error.code, failed))
    except BrokenPipeError:
        # The reader has enough (`| head`).
        from play_launch.cli.output import redirect_to_devnull  # noqa: PLC0415 - rarely needed

        redirect_to_devnull(sys.stdout)
        sys.exit(ExitCode.OK)


def _connect(session: str | None, deadline: float | None) -> ControlClient:
    if deadline is None:
        return connect(session)
    while True:
        left = deadline - time.monotonic()
        try:
            return connect(session, limit=max(left, _POLL))
        except AmbiguousSessionError:
            raise
        except NoSessionError:
            if left < _POLL:
                raise
            time.sleep(_POLL)


def report_end(hello: Hello, reason: str = "") -> int:
    """Report how a session ended that closed its connection; return the exit code.

    Args:
        hello: Which session.
        reason: Why its client gave up; empty: the connection was closed.
    """
    text, status = _how_it_ended(hello, reason)
    if status == ExitCode.OK:
        sys.stderr.write(f"{printable(text, colour=False)}\n")
    else:
        report(text)
    return status


def report(message: str) -> None:
    """Write an error to stderr; names in it may hold any character."""
    sys.stderr.write(f"error: {printable(message, colour=False)}\n")


def _how_it_ended(hello: Hello, reason: str) -> tuple[str, ExitCode]:
    name = f"session {hello.name} (pid {hello.pid})"
    try:
        connect_to(hello.folder).close()
    except NoSessionError:
        # A session that ends in order removes its socket first.
        if os.path.lexists(f"{hello.folder}/{CONTROL_SOCKET}"):
            return f"the supervisor of the {name} was killed", ExitCode.NODE_FAILED
        return f"the {name} has ended", ExitCode.OK
    except ControlError as error:
        return str(error), ExitCode.NODE_FAILED
    end = f"the {name} closed the connection{': ' if reason else ''}{reason}"
    return end, ExitCode.NODE_FAILED


def _messages(error: ControlError) -> list[str]:
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
