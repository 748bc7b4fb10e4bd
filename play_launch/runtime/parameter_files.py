"""The parameters of processes as files, as long as the system runs."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from play_launch.config.model import ProcessConfig
from play_launch.container.parameter_file import (
    ParameterFileError,
    parameter_file_of,
    write_parameter_file,
)
from play_launch.runtime.ports import StartError

if TYPE_CHECKING:
    from collections.abc import Iterable

    from play_launch.config.model import (
        ContainerConfig,
        ParameterConfig,
        ParameterSection,
    )

    Config = ContainerConfig | ProcessConfig
    Key = tuple[str, tuple[ParameterConfig, ...], tuple[ParameterSection, ...]]


class ParameterFiles:
    """The parameters of containers and ordinary processes, each in a file of its own."""

    def __init__(self, configs: Iterable[Config]) -> None:
        """Write the files; what cannot be written is reported when the file is asked for."""
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        self._paths: dict[Key, Path | StartError] = {}
        self.write(configs)

    def write(self, configs: Iterable[Config]) -> None:
        """Write the files that do not exist; old ones stay for restarts of running processes."""
        for config in configs:
            if any(_key(config)[1:]) and _key(config) not in self._paths:
                self._paths[_key(config)] = self._write(config)

    def of(self, config: Config) -> Path | None:
        """Give the file; None when there are no parameters.

        Raises:
            StartError: When a file cannot express them, or could not be written.
        """
        path = self._paths.get(_key(config))
        if isinstance(path, StartError):
            raise path
        return path

    def remove(self) -> None:
        """Remove the files; may be called twice."""
        if self._folder is not None:
            self._folder.cleanup()

    def _write(self, config: Config) -> Path | StartError:
        try:
            text = parameter_file_of(config) or ""
            if self._folder is None:
                self._folder = tempfile.TemporaryDirectory(prefix="play-launch-")
            return write_parameter_file(text, Path(self._folder.name))
        except ParameterFileError as error:
            return StartError(str(error), permanent=True)
        except OSError as error:
            reason = f"its parameters cannot be written to a temporary file: {error.strerror}"
            fix = "free some space, or set TMPDIR to another folder"
            return StartError(f"{reason}; {fix}", permanent=True)


def _key(config: Config) -> Key:
    own = config.parameters if isinstance(config, ProcessConfig) else ()
    return config.full_name, own, config.process_parameters
