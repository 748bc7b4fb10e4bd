"""Watches the files of a configuration, for ``play-launch replay --watch``."""

from __future__ import annotations

import asyncio
import logging
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final

from msgspec import Struct

from play_launch.config.load import load_config
from play_launch.config.problems import ConfigError
from play_launch.config.source import Refused, read_bytes
from play_launch.config.substitutions import Inputs
from play_launch.process.descendants import in_a_thread

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Iterable, Mapping

    from play_launch.config.model import ReplayConfig

PERIOD: Final = 0.3
"""Seconds between two checks; a change is read when two checks in a row find the same."""
_log = logging.getLogger(__name__)

Contents = dict[Path, bytes | None]
"""Content of each file; None: it cannot be read."""


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
    files = (*config.included_files, *config.parameter_files)
    contents: Contents = {watched.path: config.text, **{each.path: each.text for each in files}}
    while True:
        await asyncio.sleep(PERIOD)
        now = await in_a_thread(partial(_read, contents))
        if now == contents:
            continue
        await asyncio.sleep(PERIOD)
        if await in_a_thread(partial(_read, contents)) != now:
            continue  # it is being written
        found, contents = await in_a_thread(partial(_load, watched, config.machine))
        if isinstance(found, ConfigError):
            _log.error("%s is not applied:\n%s", watched.path, found.for_people())
        else:
            await apply(found)


def _load(watched: Watched, machine: str) -> tuple[ReplayConfig | ConfigError, Contents]:
    """Read the configuration; also give all files that were asked for, there or not.

    A mistake may be corrected in a file that no valid configuration has named yet.
    """
    contents: Contents = {}

    def read(path: Path) -> bytes | Refused:
        found = read_bytes(path)
        contents[path] = found if isinstance(found, bytes) else None
        return found

    try:
        inputs = Inputs(arguments=watched.arguments)
        return load_config(watched.path, inputs, read, machine), contents
    except ConfigError as error:
        return error, contents


def _read(files: Iterable[Path]) -> Contents:
    found = {path: read_bytes(path) for path in files}
    return {path: each if isinstance(each, bytes) else None for path, each in found.items()}
