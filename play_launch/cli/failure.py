"""Errors that a person made or can mend: reported in a sentence, never with a traceback."""

from __future__ import annotations

import sys
from typing import NoReturn

from play_launch.cli.show.terminal import printable, wants_colour
from play_launch.supervisor.exit_code import ExitCode


def fail(message: str, code: ExitCode = ExitCode.USAGE) -> NoReturn:
    """Report on stderr what is wrong and end with ``code``."""
    report(message)
    sys.exit(code)


def report(message: str) -> None:
    """Write ``error: message`` to stderr; several lines keep their form.

    Names of files and what stands in them may hold anything.
    """
    label = "\x1b[1;31merror:\x1b[0m" if wants_colour(sys.stderr) else "error:"
    print(f"{label} {printable(message, colour=False)}", file=sys.stderr, flush=True)  # noqa: T201 - what it is for
