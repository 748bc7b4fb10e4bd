"""Where the ament index says a component's library is."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

_RESOURCES: Final = ("play_launch_components", "rclcpp_components")
"""Types of the resources that list components, a line each: `class;library`."""


def component_library(package: str, plugin: str, prefixes: Iterable[Path]) -> Path | None:
    """Find the library of a component; None where no index names it. Reads files.

    Args:
        package: The package that the component is in.
        plugin: The class.
        prefixes: Where to look, the first one that has the package wins.
    """
    for prefix in prefixes:
        for resource in _RESOURCES:
            path = prefix / "share" / "ament_index" / "resource_index" / resource / package
            try:
                content = path.read_text(encoding="utf-8")
            except (OSError, ValueError):
                continue
            for line in content.splitlines():
                name, _, library = line.strip().partition(";")
                if name == plugin and library:
                    return prefix / library
    return None
