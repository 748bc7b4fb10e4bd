"""Load a configuration file."""

from __future__ import annotations

from pathlib import Path

from play_launch.config.model import ReplayConfig


def load_config(path: Path) -> ReplayConfig:
    """Read and validate the configuration at `path`; raise ConfigError with every problem."""
    raise NotImplementedError
