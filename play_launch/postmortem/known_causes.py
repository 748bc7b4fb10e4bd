"""Causes that are recognised by lines of output, of any program."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final, NamedTuple

from msgspec import Struct

from play_launch.postmortem.source_lines import SourceLine

if TYPE_CHECKING:
    from collections.abc import Sequence


class KnownCause(Struct, frozen=True):
    """One of them."""

    name: str
    says: re.Pattern[str]
    means: str
    """For people, after "that is: "."""
    fix: str


KNOWN_CAUSES: Final = (
    KnownCause(
        "disk_full",
        re.compile(r"no space left on device|ENOSPC|disk quota exceeded", re.IGNORECASE),
        "the disk is full",
        "free space there, or write elsewhere",
    ),
    KnownCause(
        "out_of_memory",
        re.compile(r"bad_alloc|MemoryError|cannot allocate memory|out of memory", re.IGNORECASE),
        "it got no more memory",
        "find what grows, or raise its limit",
    ),
    KnownCause(
        "wrong_parameter_type",
        re.compile(
            r"ParameterType(?:Error|Exception)|parameter '[^']*' has (?:the wrong|invalid) type"
        ),
        "a parameter has the wrong type",
        "give it the type that the node declares",
    ),
    KnownCause(
        "missing_symbol",
        re.compile(r"undefined symbol: \S+"),
        "a library was built against another version",
        "build the package again",
    ),
    KnownCause(
        "missing_library",
        re.compile(
            r"cannot open shared object file(?!\): ignored)|no such library|No module named '"
            r"|(?:components|resource) in (?:the )?ament index|does not exist: \S+\.so"
        ),
        "a library is missing",
        "install the package, or source its workspace",
    ),
    KnownCause(
        "missing_program",
        re.compile(r"(?:exited with status 12[67])\b|command not found"),
        "its program was not found, or cannot be executed",
        "install it, or correct the command",
    ),
    KnownCause(
        "context_shut_down",
        re.compile(r"shut the ROS context down, which all nodes of this container share"),
        "a component called rclcpp::shutdown(), or did the same",
        "set container_type: isolated, where that ends the component alone",
    ),
    KnownCause(
        "null_pointer",
        re.compile(r"SIGSEGV \(no memory at address 0x[0-9a-f]{1,3}\)"),
        "a null pointer was used",
        "",
    ),
    KnownCause(
        "stack_smashed",
        re.compile(r"stack smashing detected|buffer overflow detected"),
        "it wrote beyond a buffer",
        "build it with -fsanitize=address",
    ),
    KnownCause(
        "heap_broken",
        re.compile(r"double free|free\(\): invalid|malloc\(\): |corrupted (?:size|unsorted)"),
        "it broke the heap",
        "build it with -fsanitize=address",
    ),
    KnownCause(
        "address_in_use",
        re.compile(r"address already in use", re.IGNORECASE),
        "another program has its port",
        "end that program, or choose another port",
    ),
)
"""In the order in which they are looked for. A library of ``LD_PRELOAD`` that the loader ignores is
none of them: the program runs without it."""

_KILLED: Final = "(SIGKILL)"
BY_NAME: Final = {each.name: each for each in KNOWN_CAUSES}


_FRAME: Final = re.compile(r'  File "([^"]+)", line (\d{1,9})(?:, in (.+))?')
_EXCEPTION: Final = re.compile(r"[A-Za-z_][\w.]*(?::|$)")
_LIBRARY: Final = re.compile(r"^<|/rclpy/|/lib/python3[.\d]*/(?!(?:site|dist)-packages/)")
"""Where a line of Python is not that of a node; nodes are installed in site-packages."""
_TERMINATED: Final = re.compile(
    r"terminate called after throwing an instance of '(.+)'(?:\n  what\(\):  (.*))?"
)


class Uncaught(NamedTuple):
    """An exception that ended a program, and where it was raised, if that is known."""

    text: str
    line: SourceLine | None = None


class MatchedLine(NamedTuple):
    """A known cause, and the text that gives it away."""

    known: KnownCause
    text: str


def known_by(cause: str, last_lines: Sequence[str]) -> MatchedLine | None:
    """Find the known cause that the reason names, else the latest line that names one.

    Lines explain how a program failed. A SIGKILL comes from another process, whatever the
    program complained about before.
    """
    lines = () if _KILLED in cause else tuple(reversed(last_lines))
    # The dynamic loader exits with 127 as well, and says which library is missing.
    for text in (*lines, cause) if cause.endswith("status 127") else (cause, *lines):
        for each in KNOWN_CAUSES:
            if each.says.search(text):
                return MatchedLine(each, text)
    return None


def uncaught(cause: str, last_lines: Sequence[str]) -> Uncaught | None:
    """Find the exception that a program of Python or C++ reported before it ended."""
    if cause.endswith("status 1"):
        return _of_python(last_lines)
    if "(SIGABRT)" not in cause:
        return None
    found = _TERMINATED.search("\n".join(last_lines))
    return Uncaught(": ".join(filter(None, found.groups()))) if found else None


def _of_python(last_lines: Sequence[str]) -> Uncaught | None:
    """Take the last traceback: indented lines, and the exception behind them."""
    found, frames = None, []
    for line in last_lines:
        if frame := _FRAME.fullmatch(line):
            frames.append(SourceLine(frame[1], int(frame[2]), frame[3] or ""))
        elif frames and _EXCEPTION.match(line):
            own = [each for each in frames if not _LIBRARY.search(each.file)]
            found, frames = Uncaught(line, (own or frames)[-1]), []
    return found


def known_cause(cause: str, last_lines: Sequence[str]) -> str:
    """Return the name of that cause; empty without one."""
    said = known_by(cause, last_lines)
    return said.known.name if said else ""
