"""Collects problems while the rest of a configuration is still being looked at."""

from __future__ import annotations

from play_launch.config.problems import ConfigError, Place, Problem


class Report:
    """The problems found so far, each once.

    One report belongs to one call of `load_config`, so nothing is shared between threads.
    """

    def __init__(self) -> None:
        self._problems: dict[Problem, None] = {}

    def __len__(self) -> int:
        return len(self._problems)

    def add(self, place: Place, path: str, message: str) -> None:
        """Add the problem `message` at `place`, where `path` leads."""
        self._problems[Problem.at(place, path, message)] = None

    def raise_if_any(self, first_file: str) -> None:
        """Raise ConfigError if anything was found: `first_file` first, then by place."""
        if not self._problems:
            return
        ordered = sorted(self._problems, key=lambda found: (found.file != first_file, found))
        raise ConfigError(tuple(ordered))
