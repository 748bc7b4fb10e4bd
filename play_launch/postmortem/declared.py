"""What a recording's configuration declares about nodes and processes."""

from __future__ import annotations

import json
from pathlib import PurePath
from typing import TYPE_CHECKING, Any

from msgspec import Struct

from play_launch.postmortem.frames import Frame  # noqa: TC001 - a field of a Struct
from play_launch.postmortem.source_lines import SourceLine  # noqa: TC001 - as above

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from mcap.records import Attachment

RESOLVED: str = "resolved_config.json"


class DeclaredPlace(Struct, frozen=True, kw_only=True):
    """Where something happened; what is not known is empty."""

    frame: Frame | None = None
    line: SourceLine | None = None
    package: str = ""
    plugin: str = ""
    container: str = ""
    config: str = ""
    """``robot.yaml:12``: where it is declared."""
    command: tuple[str, ...] = ()
    """Of an ordinary process or a container."""


def declared_places(attachments: Mapping[str, Attachment]) -> dict[str, DeclaredPlace]:
    """Give the place of each declared thing, by its key; empty where it cannot be read."""
    try:
        config = json.loads(attachments[RESOLVED].data)
        return dict(_places(config))
    except (KeyError, ValueError, TypeError, AttributeError, RecursionError):
        return {}


def _places(config: dict[str, Any]) -> Iterator[tuple[str, DeclaredPlace]]:
    source = str(config.get("source", ""))
    for container in config.get("containers", ()):
        name = container["full_name"]
        yield name, DeclaredPlace(config=_line(container, source))
        for node in container.get("composable_nodes", ()):
            yield (
                node["key"],
                DeclaredPlace(
                    package=node["package"],
                    plugin=node["plugin"],
                    container=name,
                    config=_line(node, source),
                ),
            )
    for process in config.get("nodes", ()):
        command = process.get("command") or ()
        yield (
            process["full_name"],
            DeclaredPlace(
                package=process.get("package") or "",
                config=_line(process, source),
                command=tuple(map(str, command)),
            ),
        )


def _line(declared: dict[str, Any], source: str) -> str:
    # An older recording names no file: it has only one.
    file = PurePath(str(declared.get("file") or source)).name
    return f"{file}:{declared['line']}"
