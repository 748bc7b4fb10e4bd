"""The configuration that a session was started with, from its recording.

The YAML and the parameter files as they were given are read once more, rather than their resolved
form.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from msgspec import Struct

from play_launch.config.load import parse_config
from play_launch.config.problems import ConfigError, Location, Problem
from play_launch.config.source import MCAP_MESSAGE, Refused, read_bytes
from play_launch.config.substitutions import Inputs, share_folder
from play_launch.postmortem.bag_reader import BagReader, NotARecordingError
from play_launch.recording.resolved_form import kept
from play_launch.recording.session import INCLUDED, PARAMETERS
from play_launch.recording.topics import METADATA_NAME, RESOLVED

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from mcap.records import Attachment

    from play_launch.config.model import ReplayConfig

_CONFIG: Final = "config."


class RecordedConfig(Struct, frozen=True):
    """What stands at the head of a recording about the system."""

    config: ReplayConfig
    resolved: Mapping[str, Any]
    """The configuration as it was resolved then."""
    about: Mapping[str, str]
    """The metadata of the session."""
    environment: Mapping[str, str]
    """As it was recorded: without secrets."""


def recorded_config(path: Path, arguments: Mapping[str, str] | None = None) -> RecordedConfig:
    """Read the configuration of a recording, be it finished or not.

    `arguments` take the place of those that were given then.

    Raises:
        ConfigError: When it holds none, or one that this version does not accept.
    """
    reader = BagReader(path)
    try:
        # The head is before the first message.
        next(reader.messages(), None)
    except NotARecordingError as error:
        message = str(error).removeprefix(f"{path}: ")
        raise ConfigError((Problem.at(Location(str(path), 1, 1), "(file)", message),)) from error
    attached = reader.attachments
    name = next((each for each in attached if each.startswith(_CONFIG)), None)
    if name is None or METADATA_NAME not in reader.metadata:
        raise ConfigError((Problem.at(Location(str(path), 1, 1), "(file)", MCAP_MESSAGE),))
    resolved = _object(attached, RESOLVED)
    source = Path(str(resolved.get("source") or path.with_name(name)))
    files = [
        *_files(attached, INCLUDED, resolved.get("included_files", ())),
        *_files(attached, PARAMETERS, resolved.get("parameter_files", ())),
    ]
    inputs = _inputs(_mapping(resolved.get("taken")), arguments or {}, os.environ)
    config = parse_config(attached[name].data, source, _RecordedFiles(files), inputs)
    return RecordedConfig(
        config, resolved, reader.metadata[METADATA_NAME], _object(attached, "environment.json")
    )


def _inputs(
    taken: Mapping[str, Any], arguments: Mapping[str, str], environ: Mapping[str, str]
) -> Inputs:
    """Give what the configuration took then; secrets, which were not recorded, come from here."""
    variables = _mapping(taken.get("variables"))
    unset = {name for name, value in variables.items() if value is None}
    packages = _mapping(taken.get("packages"))

    def find_share(package: str) -> Path | None:
        here = share_folder(package)
        # Its files are in the recording, by the path that they had.
        return here or (Path(str(packages[package])) if package in packages else None)

    return Inputs(
        arguments={**kept(_mapping(taken.get("arguments"))), **arguments},
        environ={
            **{name: value for name, value in environ.items() if name not in unset},
            **kept(variables),
        },
        find_share=find_share,
    )


def _mapping(values: object) -> dict[str, Any]:
    return values if isinstance(values, dict) else {}


class _RecordedFiles:
    """Gives the recorded files by the paths that they had, or by their names in their order."""

    def __init__(self, files: list[tuple[Path, bytes]]) -> None:
        self._left = files

    def __call__(self, path: Path) -> bytes | Refused:
        same = [each for each in self._left if each[0] == path]
        # The home of another user is elsewhere.
        alike = [each for each in self._left if each[0].name == path.name]
        for each in (*same, *alike):
            self._left.remove(each)
            return each[1]
        return read_bytes(path)


def _files(
    attached: Mapping[str, Attachment], kind: str, listed: Iterable[object]
) -> list[tuple[Path, bytes]]:
    paths = [Path(str(path)) for path in listed]
    files = []
    for name, each in attached.items():
        number, _, file = name.removeprefix(kind).partition("-")
        if name.startswith(kind) and number.isdecimal():
            path = paths[int(number)] if int(number) < len(paths) else Path(file)
            files.append((path, each.data))
    return files


def _object(attached: Mapping[str, Attachment], name: str) -> dict[str, Any]:
    try:
        values = json.loads(attached[name].data)
    except (KeyError, ValueError, RecursionError):
        return {}
    return values if isinstance(values, dict) else {}
