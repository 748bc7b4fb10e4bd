"""Watches the files of a configuration, for ``play-launch replay --watch``."""

from __future__ import annotations

import asyncio
import logging
from pathlib import Path
from typing import TYPE_CHECKING, Final

from msgspec import Struct

from play_launch.config.load import load_config
from play_launch.config.problems import ConfigError
from play_launch.config.source import Refused, read_bytes
from play_launch.config.substitutions import Inputs

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Iterable, Mapping

    from play_launch.config.model import ReplayConfig

PERIOD: Final = 0.3
"""Seconds between two checks; files are read when two checks in a row find the same."""
_log = logging.getLogger(__name__)

Stamps = tuple[tuple[int, int, int] | None, ...]
Contents = dict[Path, bytes | Refused]
"""Content of each file, or why it was not read."""


class Watched(Struct, frozen=True):
    """Arguments of the command line."""

    path: Path
    arguments: Mapping[str, str]


async def watch(
    watched: Watched, config: ReplayConfig, apply: Callable[[ReplayConfig], Awaitable[None]]
) -> None:
    """Apply the configuration whenever it, or a file it includes or names, has changed.

    A configuration with mistakes is reported, and nothing is done until the next change.
    """
    contents = _contents_of(watched.path, config)
    seen = await asyncio.to_thread(_stamps, contents)
    if not await asyncio.to_thread(_are_the_same, contents):
        seen = ()  # it was changed while the system came up
    while True:
        await asyncio.sleep(PERIOD)
        now = await asyncio.to_thread(_stamps, contents)
        if now == seen:
            continue
        await asyncio.sleep(PERIOD)
        if await asyncio.to_thread(_stamps, contents) != now:
            continue  # it is being written
        found, contents = await asyncio.to_thread(_load, watched)
        seen = await asyncio.to_thread(_stamps, contents)
        if not await asyncio.to_thread(_are_the_same, contents):
            seen = ()  # it was changed while it was read
        elif isinstance(found, ConfigError):
            _log.error("%s is not applied:\n%s", watched.path, found.for_people())
        else:
            await apply(found)


def _contents_of(path: Path, config: ReplayConfig) -> Contents:
    others = (*config.included_files, *config.parameter_files)
    return {path: config.text, **{each.path: each.text for each in others}}


def _load(watched: Watched) -> tuple[ReplayConfig | ConfigError, Contents]:
    """Read the configuration; also give all files that were asked for, there or not.

    A mistake may be corrected in a file that no valid configuration has named yet.
    """
    contents: Contents = {}

    def read(path: Path) -> bytes | Refused:
        contents[path] = found = read_bytes(path)
        return found

    given = Inputs(arguments=watched.arguments)
    try:
        return load_config(watched.path, given, read), contents
    except ConfigError as error:
        return error, contents


def _stamps(files: Iterable[Path]) -> Stamps:
    return tuple(_stamp(path) for path in files)


def _stamp(path: Path) -> tuple[int, int, int] | None:
    try:
        status = path.stat()
    except OSError:
        return None  # editors remove a file and write it anew
    # Not the time of its content, which a copy may keep.
    return status.st_ctime_ns, status.st_size, status.st_ino


def _are_the_same(contents: Contents) -> bool:
    """Whether the files still hold what was read, or still cannot be read."""
    return all(
        _comparable(read_bytes(path)) == _comparable(each) for path, each in contents.items()
    )


def _comparable(content: bytes | Refused) -> bytes | None:
    return None if isinstance(content, Refused) else content
