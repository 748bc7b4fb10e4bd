"""Writes a description as the text of a configuration, and looks for mistakes in it."""

from __future__ import annotations

from pathlib import Path  # noqa: TC003 - msgspec reads the annotations
from typing import TYPE_CHECKING

from msgspec import Struct

from play_launch.config.load import parse_config
from play_launch.config.problems import ConfigError, Problem
from play_launch.config.source import Refused, read_bytes
from play_launch.config.substitutions import Inputs
from play_launch.launch_files.configuration.files import Copies
from play_launch.launch_files.configuration.from_records import configuration_of
from play_launch.launch_files.configuration.yaml_text import printable, yaml_text
from play_launch.launch_files.records import (
    Loss,
    Losses,
)

if TYPE_CHECKING:
    from collections.abc import Mapping

    from play_launch.launch_files.configuration.request import Options
    from play_launch.launch_files.records import Description


class Written(Struct, frozen=True):
    """A configuration, what it does not say, and what `check` finds in it.

    `files` are to stand at their absolute paths.
    """

    text: str
    files: dict[Path, bytes]
    losses: tuple[Loss, ...]
    problems: tuple[Problem, ...]
    containers: int
    composable_nodes: int
    processes: int

    @property
    def lost(self) -> int:
        """How much could not be carried over; notes are not counted."""
        return sum(not loss.is_note for loss in self.losses)


def written(description: Description, options: Options, heading: str) -> Written:
    """Return the configuration, below a comment of one or more lines."""
    losses = Losses(description.losses)
    copies = None if options.files is None or options.inline else Copies(options.files)
    made = configuration_of(description, options, copies, losses)
    files = copies.files if copies is not None else {}
    comment = "".join(f"# {printable(line)}\n" for line in heading.splitlines())
    text = f"{comment}{yaml_text(made)}"
    containers = made.get("containers", [])
    return Written(
        text=text,
        files=files,
        losses=tuple(losses),
        problems=_problems(text, files, options),
        containers=len(containers),
        composable_nodes=sum(len(each.get("composable_nodes", ())) for each in containers),
        processes=len(made.get("nodes", ())),
    )


def _problems(text: str, files: Mapping[Path, bytes], options: Options) -> tuple[Problem, ...]:
    place = options.folder / "(the configuration)"

    def read(path: Path) -> bytes | Refused:
        return files[path] if path in files else read_bytes(path)

    try:
        parse_config(text.encode(), place, read, Inputs())
    except ConfigError as error:
        return error.problems
    return ()
