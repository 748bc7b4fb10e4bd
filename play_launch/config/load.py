"""Load a configuration file."""

from __future__ import annotations

from typing import TYPE_CHECKING

from play_launch.config.problems import ConfigError, Place, Problem, Report
from play_launch.config.resolve.system import resolve_document
from play_launch.config.source import Refused, decode, read_bytes
from play_launch.config.yaml.compose import compose
from play_launch.config.yaml.scalars import ScalarKind
from play_launch.config.yaml.tree import Scalar

if TYPE_CHECKING:
    from pathlib import Path

    from play_launch.config.model import ReplayConfig


def load_config(path: Path) -> ReplayConfig:
    """Read and validate the configuration at `path`, and the parameter files it names.

    Raises ConfigError with every problem found. Reading files is the only effect; calls from
    different threads do not meet.
    """
    content = read_bytes(path)
    if isinstance(content, Refused):
        raise ConfigError((Problem.at(content.place, "(file)", content.message),))
    return parse_config(content, path)


def parse_config(content: bytes, source: Path) -> ReplayConfig:
    """Validate `content` as if it had been read from `source`; raise ConfigError as above."""
    file = str(source)
    text = decode(content, file)
    if isinstance(text, Refused):
        raise ConfigError((Problem.at(text.place, "(file)", text.message),))
    report = Report()
    root = compose(text, file, report)
    report_is_empty = len(report) == 0
    if root is None or (isinstance(root, Scalar) and root.kind is ScalarKind.NULL):
        if report_is_empty:
            place = Place(file, 1, 1) if root is None else root.place
            report.add(place, "(file)", "holds no configuration; begin with version: 1")
        report.raise_if_any(file)
        raise AssertionError("a missing tree was not reported")
    config = resolve_document(root, source, content, report)
    report.raise_if_any(file)
    assert config is not None
    return config
