"""What may be asked for when a configuration is written."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path

from msgspec import Struct, field


class Containers(StrEnum):
    """Container type for containers of rclcpp_components."""

    SAME = "same"
    """A container of ours that does the same."""
    ISOLATED = "isolated"
    """One of ours whose nodes are processes of their own."""
    STOCK = "stock"
    """They stay what they are."""


class Options(Struct, frozen=True, kw_only=True):
    """How a configuration is written.

    With `show_all`, the output of all processes is shown. With `inline`, parameter files are copied
    into the configuration instead of referenced. `folder` is where the configuration will stand;
    paths below it are written relative to it. `files` is a folder for temporary files and long
    texts; None: there are to be no files besides.
    """

    containers: Containers = Containers.SAME
    show_all: bool = False
    inline: bool = False
    folder: Path = field(default_factory=Path.cwd)
    files: Path | None = None
