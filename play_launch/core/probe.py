"""What a scratch process that loaded a library came to.

It is `component_container --probe PACKAGE PLUGIN`. Its last line on standard output is one JSON
object: ``{"library": str, "error": str, "signal": int, "modules": [str, ...], "backtrace":
[str, ...]}``, the lists as in a ComponentEvent. Its exit status is 0 when the library can be loaded
and 1 when it cannot.
"""

from __future__ import annotations

import json
import signal as signals
from typing import TYPE_CHECKING, Any, Final

from msgspec import Struct

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

UNUSABLE: Final = frozenset({64, 125, 126, 127})
"""Exit codes of a program that did not understand its arguments, or was never executed."""

_QUOTES: Final = 4
"""Quotation marks up to the end of the last whole entry of a list that was cut."""


class Finding(Struct, frozen=True, kw_only=True):
    """How it ended."""

    loads: bool
    library: str = ""
    """Its path; empty where nothing is known."""
    error: str = ""
    """Why it cannot be loaded."""
    exit_code: int = 0
    signal: int = 0
    modules: tuple[str, ...] = ()
    """Libraries of the backtrace, as in a `ComponentEvent`."""
    backtrace: tuple[str, ...] = ()
    """Innermost first."""

    @property
    def is_about_library(self) -> bool:
        """Whether it holds for every component of the library, not only for the one asked for."""
        return self.loads or self.signal != 0


def read_probe(lines: Iterable[str], *, exit_code: int = 0, signal: int = 0) -> Finding | None:
    """Read the end of a scratch process; None when it never was one.

    Args:
        lines: What it wrote to standard output; a library may write there as well.
        exit_code: Its exit status; 0 when a signal ended it.
        signal: The signal that ended it; 0 when none did.
    """
    result = _last_object(lines)
    if result is None and exit_code in UNUSABLE:
        return None
    number = signal or _number(result, "signal")
    # Without a word it did not come to its end, whatever its status is: exit() in an initialiser.
    loads = result is not None and exit_code == 0 and number == 0
    ending = f"ended with {_name(number)}" if number else f"exited with status {exit_code}"
    return Finding(
        loads=loads,
        library=_text(result, "library"),
        error="" if loads else _text(result, "error") or f"the process that loaded it {ending}",
        exit_code=exit_code,
        signal=number,
        modules=_texts(result, "modules"),
        backtrace=_texts(result, "backtrace"),
    )


def overdue(seconds: float) -> Finding:
    """Return what is found when it was killed because it took too long."""
    return Finding(loads=False, error=f"its library was still being loaded after {seconds:g} s")


def _last_object(lines: Iterable[str]) -> Mapping[str, Any] | None:
    found = None
    for line in lines:
        if line.startswith("{"):
            for text in _readings(line):
                value = _object(text)
                if "library" in value:
                    found = value
                    break
    return found


def _readings(line: str) -> Iterator[str]:
    """Give the line, and what it was if it has been cut in its backtrace, being too long."""
    yield line
    end = len(line)
    for _ in range(_QUOTES):
        end = line.rfind('"', 0, end)
        yield line[: end + 1] + "]}"


def _object(text: str) -> Mapping[str, Any]:
    try:
        value = json.loads(text)
    except ValueError:
        return {}
    return value if isinstance(value, dict) else {}


def _number(result: Mapping[str, Any] | None, name: str) -> int:
    value = result.get(name) if result else None
    return value if isinstance(value, int) and value > 0 else 0


def _text(result: Mapping[str, Any] | None, name: str) -> str:
    value = result.get(name) if result else None
    return value if isinstance(value, str) else ""


def _texts(result: Mapping[str, Any] | None, name: str) -> tuple[str, ...]:
    value = result.get(name) if result else None
    return tuple(map(str, value)) if isinstance(value, list) else ()


def _name(number: int) -> str:
    try:
        return f"signal {number} ({signals.Signals(number).name})"
    except ValueError:
        return f"signal {number}"
