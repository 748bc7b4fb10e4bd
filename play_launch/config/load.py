"""Load a configuration file."""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING

from msgspec.structs import replace

from play_launch.config.model import SourceFile, TakenValues
from play_launch.config.problems import ConfigError, Problem, Report
from play_launch.config.resolve.system import resolve_document
from play_launch.config.source import Refused, read_bytes
from play_launch.config.sources.documents import Documents
from play_launch.config.sources.surroundings import Surroundings, Taken

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from play_launch.config.model import ReplayConfig


def load_config(
    path: Path,
    surroundings: Surroundings | None = None,
    read: Callable[[Path], bytes | Refused] = read_bytes,
) -> ReplayConfig:
    """Read and validate the configuration at `path`, and the files it includes and names.

    Raises ConfigError with every problem found. Reading files, by `read`, is the only effect;
    calls from different threads do not meet.
    """
    content = read(path)
    if isinstance(content, Refused):
        raise ConfigError((Problem.at(content.place, "(file)", content.message),))
    return parse_config(content, path, read, surroundings)


def parse_config(
    content: bytes,
    source: Path,
    read: Callable[[Path], bytes | Refused] = read_bytes,
    surroundings: Surroundings | None = None,
) -> ReplayConfig:
    """Validate `content` as if it had been read from `source`; raise ConfigError as above.

    `read` gives the other files.
    """
    report = Report()
    taken = Taken(surroundings or Surroundings())
    documents = Documents(report, read, taken)
    root = documents.read(content, source)
    config = None if root is None else resolve_document(root, source, content, report, read)
    report.raise_if_any(str(source))
    assert config is not None
    if not documents.included and not taken.is_touched:
        return config
    values = TakenValues(
        arguments=MappingProxyType(taken.arguments),
        variables=MappingProxyType(taken.variables),
        packages=MappingProxyType(taken.packages),
    )
    included = tuple(SourceFile(path, text) for path, text in documents.included.items())
    return replace(config, included_files=included, taken=values)
