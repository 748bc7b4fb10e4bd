"""Errors of launch files in words: the first one, not those that follow from it."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Final
from xml.etree.ElementTree import ParseError

import yaml

from play_launch.launch_files.records import Place
from play_launch.launch_files.ros_launch.job import most_memory

if TYPE_CHECKING:
    from play_launch.launch_files.ros_launch.places import Places

_SAID: Final = frozenset(
    {"RuntimeError", "Exception", "SubstitutionFailure", "PackageNotFoundError"}
)
"""Errors whose class adds nothing to their text."""


def trail(error: BaseException) -> list[BaseException]:
    """Return the first of the errors that launch collects, and those that followed from it."""
    found = [error]
    while likely := getattr(found[0], "_likely_errors", None):
        found.insert(0, likely[0])
    return found


def reason_of(error: BaseException, places: Places) -> tuple[str, Place]:
    """Return what is wrong, and where if the error itself has the place."""
    file = places.files[-1] if places.files else ""
    if isinstance(error, SystemExit):
        code = 0 if error.code is None else error.code
        return f"it calls exit({code!r}) while it is evaluated", places.of_traceback(
            error.__traceback__
        )
    # A ParseError is a SyntaxError, too.
    if isinstance(error, ParseError):
        what = str(error).rpartition(": line ")[0]
        return f"is not XML: {what}", Place(file, error.position[0])
    if isinstance(error, SyntaxError):
        return f"SyntaxError: {error.msg}", Place(error.filename or file, error.lineno or 0)
    if isinstance(error, yaml.MarkedYAMLError) and error.problem_mark is not None:
        mark = error.problem_mark
        named = mark.name if Path(str(mark.name)).is_file() else file
        return f"is not YAML: {error.problem}", Place(named, mark.line + 1)
    if isinstance(error, UnicodeDecodeError):
        where = places.of_traceback(error.__traceback__)
        return f"is not UTF-8 at byte {error.start}", where if where.file else Place(file)
    if isinstance(error, MemoryError):
        what = f"it takes more than {most_memory() / 2**30:.3g} GiB of memory"
        return what, places.of_traceback(error.__traceback__)
    if isinstance(error, RecursionError):
        what = "it is nested too deeply, or calls itself without end"
        return what, places.of_traceback(error.__traceback__)
    if isinstance(error, OSError) and error.strerror and error.filename:
        named = os.fsdecode(error.filename)
        return f"{error.strerror}: {named}", places.of_traceback(error.__traceback__)
    return _text(error), places.of_traceback(error.__traceback__)


def _text(error: BaseException) -> str:
    kind = type(error).__name__
    # A KeyError shows its text in quotes.
    text = str(error.args[0]) if isinstance(error, KeyError) and error.args else str(error)
    if text.startswith("Required launch argument"):
        return f"{text.rstrip('.')}; give it as name:=value"
    if type(error).__module__.split(".")[0] == "lark":
        # What the grammar expects follows in many lines.
        return f"a substitution is not written as launch wants it: {text.splitlines()[0]}"
    return text if kind in _SAID and text else f"{kind}: {text}" if text else kind
