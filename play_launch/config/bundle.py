"""A configuration as the bytes that it was read from, to be read anew in another process.

What comes out is the same configuration, whatever environment and working directory are there.
"""

from __future__ import annotations

from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import msgspec
from msgspec import Struct, field

from play_launch.config.load import parse_config
from play_launch.config.problems import Place
from play_launch.config.source import Refused
from play_launch.config.sources.surroundings import Surroundings

if TYPE_CHECKING:
    from play_launch.config.model import ReplayConfig


class BundledFile(Struct, frozen=True):
    """A file by its absolute path; in JSON its bytes are base64."""

    path: str
    text: bytes


class Bundle(Struct, frozen=True, kw_only=True):
    """Everything that a configuration was made from; `variables` that were not set are None."""

    source: BundledFile
    files: tuple[BundledFile, ...] = ()
    arguments: dict[str, str] = field(default_factory=dict)
    variables: dict[str, str | None] = field(default_factory=dict)
    packages: dict[str, str] = field(default_factory=dict)


def bundled(config: ReplayConfig) -> dict[str, Any]:
    """Return what a configuration was made from, in values that `json.dumps` takes."""
    others = (*config.included_files, *config.parameter_files)
    bundle = Bundle(
        source=BundledFile(str(config.source.absolute()), config.text),
        files=tuple(BundledFile(str(each.path.absolute()), each.text) for each in others),
        arguments=dict(config.taken.arguments),
        variables=dict(config.taken.variables),
        packages=dict(config.taken.packages),
    )
    values: dict[str, Any] = msgspec.to_builtins(bundle)
    return values


def unbundled(values: object) -> ReplayConfig:
    """Read what `bundled` returned.

    Raises:
        ValueError: When it is something else.
        ConfigError: When this version does not accept the configuration.
    """
    bundle = msgspec.convert(values, Bundle)
    files = {each.path: each.text for each in bundle.files}

    def read(path: Path) -> bytes | Refused:
        found = files.get(str(path.absolute()))
        if found is not None:
            return found
        return Refused(Place(str(path), 1, 1), "is not among the files of the configuration")

    def find_share(package: str) -> Path | None:
        found = bundle.packages.get(package)
        return None if found is None else Path(found)

    set_ones = {name: value for name, value in bundle.variables.items() if value is not None}
    surroundings = Surroundings(
        arguments=MappingProxyType(bundle.arguments),
        environ=MappingProxyType(set_ones),
        find_share=find_share,
    )
    return parse_config(bundle.source.text, Path(bundle.source.path), read, surroundings)
