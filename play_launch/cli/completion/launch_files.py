"""Completes ``PKG FILE name:=value``: packages, their launch files, and what these declare."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

from play_launch.cli.completion.candidates import Candidate
from play_launch.config.ament_index import ament_prefixes
from play_launch.config.sources.surroundings import share_folder
from play_launch.launch_files.find import ENDINGS, find, launch_files
from play_launch.launch_files.records import LaunchFileError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from play_launch.launch_files.records import Argument, Description

_TIME: Final = 3.0
"""Seconds for which a key may wait for a launch file in Python."""
_TRUTH: Final = ("true", "false")


class Found(NamedTuple):
    """What fits; `goes_on` where the word is not at its end then."""

    candidates: list[Candidate]
    goes_on: bool = False


def launch_words(given: Sequence[str], typed: str) -> Found | None:
    """Return what fits behind the words that stand before; None: the path of a file."""
    named = [each for each in given if ":=" not in each]
    if not named:
        is_path = "/" in typed or typed.startswith(("~", "."))
        found = [] if is_path else [*_packages(typed), *_files_here(typed)]
        return Found(found) if found else None
    if len(named) == 1 and not Path(named[0]).expanduser().is_file():
        share = share_folder(named[0])
        names = launch_files(share) if share is not None else []
        return Found([Candidate(name) for name in names if name.startswith(typed)])
    taken = {each.partition(":=")[0] for each in given if ":=" in each}
    return _argument_words(_arguments(named), taken, typed)


def _packages(typed: str) -> list[Candidate]:
    names: set[str] = set()
    for prefix in (Path(sys.prefix), *ament_prefixes(os.environ)):
        try:
            index = prefix / "share/ament_index/resource_index/packages"
            names |= {each.name for each in index.iterdir()}
        except OSError:
            continue
    return [Candidate(name, "package") for name in sorted(names) if name.startswith(typed)]


def _files_here(typed: str) -> list[Candidate]:
    try:
        names = sorted(each.name for each in Path().iterdir())
    except OSError:
        return []
    return [
        Candidate(name, "file")
        for name in names
        if name.startswith(typed) and not name.startswith(".") and name.endswith(ENDINGS)
    ]


def _argument_words(declared: Sequence[Argument], taken: set[str], typed: str) -> Found:
    name, is_assigned, value = typed.partition(":=")
    if is_assigned:
        values = (each for argument in declared if argument.name == name for each in _of(argument))
        fitting = dict.fromkeys(each for each in values if each.startswith(value))
        return Found([Candidate(f"{name}:={each}") for each in fitting])
    found = [
        Candidate(f"{each.name}:=", _about(each))
        for each in declared
        if each.name.startswith(typed) and each.name not in taken
    ]
    return Found(found, goes_on=True)


def _of(argument: Argument) -> Sequence[str]:
    """Return values that an argument may have."""
    if argument.choices:
        return argument.choices
    default = argument.default or ""
    if default.lower() in _TRUTH:
        return _TRUTH if default.islower() else [each.capitalize() for each in _TRUTH]
    return [default] if default else []


def _about(argument: Argument) -> str:
    default = "required" if argument.default is None else f"default: {argument.default}"
    text = " ".join(argument.description.split())
    return f"{text} ({default})" if text else default


def _arguments(named: list[str]) -> list[Argument]:
    try:
        return _evaluated(find(named)).arguments
    except (LaunchFileError, OSError, ImportError, RuntimeError):
        # It is as if it declared none: whoever runs it is going to see why.
        return []


def _evaluated(path: Path) -> Description:
    from play_launch.launch_files.markup import evaluate as markup  # noqa: PLC0415 - slow
    from play_launch.launch_files.ros_launch import evaluate as ros_launch  # noqa: PLC0415

    try:
        # Starts no programs, and is done in no time.
        return markup.evaluate(path, {}, limit=0, only_arguments=True)
    except LaunchFileError:
        if not ros_launch.is_installed():
            raise
    return ros_launch.evaluate(path, {}, limit=_TIME, only_arguments=True)
