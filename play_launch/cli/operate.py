"""What the verbs for a running session have in common: their options, their errors.

They are done before typer would be imported, and import as little as they can: whoever looks at a
robot looks often.
"""

from __future__ import annotations

import os
import sys
import time
from argparse import ArgumentParser, ArgumentTypeError, HelpFormatter, Namespace
from contextlib import suppress
from importlib import import_module
from typing import TYPE_CHECKING, Final, Protocol, cast

from play_launch.cli.session_verbs import SESSION_VERBS
from play_launch.control.protocol import Code, ControlError
from play_launch.control.registration import CONTROL_SOCKET
from play_launch.control.sessions import (
    AmbiguousSessionError,
    NoSessionError,
    connect,
    connect_to,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from play_launch.control.client import ControlClient, Hello

OK: Final = 0
FAILED: Final = 1
USAGE: Final = 2
NOT_IN_TIME: Final = 3
_POLL: Final = 0.05
_LONGEST_LIMIT: Final = 1e6
_EXIT_CODES: Final = {
    Code.BAD_ARGUMENTS: USAGE,
    Code.UNKNOWN_NAME: USAGE,
    Code.AMBIGUOUS_NAME: USAGE,
    Code.TIMEOUT: NOT_IN_TIME,
}

_FAILED_AS: Final = {"diff": USAGE}
"""The verb of which 1 says something else: that something differs."""


class Verb(Protocol):
    """The module of a verb."""

    def add_arguments(self, parser: ArgumentParser, verb: str) -> None:
        """Declare what only this verb takes."""

    def run(self, client: ControlClient, options: Namespace) -> int:
        """Do what ``options.verb`` says and return the exit code; raises ControlError."""


def main(arguments: Sequence[str]) -> int:
    """Run one of the verbs; ``arguments`` start with it. Returns the exit code."""
    verb = _module_of(arguments[0])
    parser = parser_of(arguments[0])
    # Options may stand between names, where these are not those of a verb below.
    parse = parser.parse_args if arguments[0] == "param" else parser.parse_intermixed_args
    options = parse(arguments[1:])
    try:
        with _connected(options) as client:
            status = verb.run(client, options)
        sys.stdout.flush()
    except NoSessionError as error:
        _report(str(error))
        return _FAILED_AS.get(options.verb, FAILED)
    except ControlError as error:
        for message in _messages(error):
            _report(message)
        return _EXIT_CODES.get(error.code, _FAILED_AS.get(options.verb, FAILED))
    except BrokenPipeError:
        # The reader has seen enough (`| head`).
        from play_launch.cli.output import redirect_to_devnull  # noqa: PLC0415 - rarely needed

        redirect_to_devnull(sys.stdout)
        return OK
    except KeyboardInterrupt:
        return 130
    return status


class _Help(HelpFormatter):
    """Lays help out; argparse would import shutil for the width at every start."""

    def __init__(self, prog: str) -> None:
        try:
            columns = int(os.environ.get("COLUMNS") or 0) or os.get_terminal_size().columns
        except (OSError, ValueError):
            columns = 0
        super().__init__(prog, width=(columns or 80) - 2)


def _connected(options: Namespace) -> ControlClient:
    """Connect; where somebody waits anyway, for a session that begins in that time."""
    if options.verb != "wait":
        return connect(options.session)
    options.deadline = time.monotonic() + options.timeout
    while True:
        left = options.deadline - time.monotonic()
        try:
            return connect(options.session, limit=max(left, _POLL))
        except AmbiguousSessionError:
            raise
        except NoSessionError:
            if left < _POLL:
                raise
            time.sleep(_POLL)


def _module_of(name: str) -> Verb:
    return cast("Verb", import_module(f"play_launch.cli.{SESSION_VERBS[name][0]}"))


def parser_of(name: str) -> ArgumentParser:
    """Build the parser of a verb."""
    verb, about = _module_of(name), SESSION_VERBS[name][1]
    parser = ArgumentParser(prog=f"play-launch {name}", description=about, formatter_class=_Help)
    parser.set_defaults(verb=name)
    verb.add_arguments(parser, name)
    parser.add_argument(
        "--session",
        metavar="SESSION",
        help="folder, name or pid of the session, where several are running",
    )
    parser.add_argument("--json", action="store_true", help="for programs")
    return parser


def seconds(text: str) -> float:
    """Read a time limit of a command line; raises ArgumentTypeError."""
    with suppress(ValueError):
        value = float(text)
        # What is longer does not fit into a time limit of the kernel's.
        if 0 < value <= _LONGEST_LIMIT:
            return value
    raise ArgumentTypeError(f"{text!r} is no number of seconds, more than 0, up to a million")


def add_names(parser: ArgumentParser, what: str, *, optional: bool = False) -> None:
    """Declare names; they may be patterns."""
    parser.add_argument(
        "names",
        nargs="*" if optional else "+",
        metavar="NAME",
        help=f"{what}: full names, patterns such as '/sensing/*', or the last part where only one "
        "has it",
    )


def report_end(hello: Hello, reason: str = "") -> int:
    """Report how a session ended that says nothing any more; return the exit code.

    Args:
        hello: Which session.
        reason: Why its client gave up; empty: the connection was closed.
    """
    from play_launch.cli.output import printable  # noqa: PLC0415 - rarely needed

    text, status = _how_it_ended(hello, reason)
    if status == OK:
        sys.stderr.write(f"{printable(text, colour=False)}\n")
    else:
        _report(text)
    return status


def _how_it_ended(hello: Hello, reason: str) -> tuple[str, int]:
    name = f"session {hello.name} (pid {hello.pid})"
    try:
        connect_to(hello.folder).close()
    except NoSessionError:
        # A session that ends in order removes its socket first.
        if os.path.lexists(f"{hello.folder}/{CONTROL_SOCKET}"):
            return f"the supervisor of the {name} was killed", FAILED
        return f"the {name} has ended", OK
    except ControlError as error:
        return str(error), FAILED
    return f"the {name} closed the connection{': ' if reason else ''}{reason}", FAILED


def _messages(error: ControlError) -> list[str]:
    """Say what failed, a line for each of several."""
    results = error.details.get("results")
    if error.code != Code.FAILED or not isinstance(results, list):
        return [str(error)]
    failed = [f"{each['name']}: {each['reason']}" for each in results if not each["done"]]
    return failed or [str(error)]


def _report(message: str) -> None:
    """Write an error; what nodes and command lines put into it may hold anything."""
    from play_launch.cli.output import printable  # noqa: PLC0415 - rarely needed

    sys.stderr.write(f"error: {printable(message, colour=False)}\n")
